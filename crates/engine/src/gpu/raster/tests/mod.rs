//! The rasteriser against the CPU engine, and against f64 where the CPU's f32 is not more accurate.

mod backward;
mod cases;
mod exact;
mod shaded;

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::cpu::{AttributeSource as CpuSource, Pass};
use crate::gpu::model::{LayoutUniform, planar};
use crate::gpu::raster::records::DispatchParams;
use crate::gpu::raster::{BlendEnd, Blended, GRADIENT_HEADER, RasterCounts, SplatRecord};
use crate::gpu::shaders::assert_layout;
use crate::gpu::{AttributeSource, Buffer, CameraUniform, Gpu, Groups, Raster, groups, shaders, uniform};
use crate::{DeviceError, RasterCamera};
use relume_compare::worst;
use relume_layout::channel::Channels;
use relume_layout::constants::{EarlyStop, TRANSMITTANCE_STOP};
use relume_scene::{Camera, Field, Gaussians, IndirectForm, MAX_LIGHTS, NormalForm, ShadingOptions};

/// A model, a camera and the other inputs of both engines.
pub(super) struct RasterScene {
    pub(super) gaussians: Gaussians,
    pub(super) prototypes: Vec<[f32; 3]>,
    pub(super) gathered: Vec<[f32; 6]>,
    pub(super) arriving: Vec<[f32; MAX_LIGHTS]>,
    pub(super) basis: [[f32; 3]; 16],
    pub(super) options: ShadingOptions,
    pub(super) view: RasterCamera,
}

impl RasterScene {
    /// `n` random Gaussians in front of a camera of `size` pixels, with visibility of degree `sh_degree`.
    pub(super) fn random(seed: u64, n: usize, size: (u32, u32), sh_degree: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut uniform = move |lo: f32, hi: f32| lo + (hi - lo) * rng.random::<f32>();
        let mut gaussians = Gaussians::zeroed(n, 5, sh_degree, 2);
        let ranges = |field| match field {
            Field::Mean => (-1.0, 1.0),
            Field::LogScale => (-4.0, -1.8),
            Field::OpacityLogit => (-3.0, 3.0),
            Field::Radiance => (-0.5, 0.5),
            // Some Gaussians are enlarged, some are not.
            Field::SamplingRate => (5.0, 60.0),
            _ => (-1.0, 1.0),
        };
        for field in Field::ALL {
            let (lo, hi) = ranges(field);
            gaussians.field_mut(field).iter_mut().for_each(|v| *v = uniform(lo, hi));
        }
        // No photograph shows some.
        gaussians.field_mut(Field::SamplingRate).iter_mut().step_by(11).for_each(|rate| *rate = -*rate);
        let prototypes = (0..5).map(|_| [uniform(-0.2, 1.2), uniform(0.0, 1.0), uniform(0.0, 1.0)]).collect();
        let gathered = (0..n).map(|_| std::array::from_fn(|_| uniform(0.0, 1.0))).collect();
        let basis = std::array::from_fn(|_| [uniform(-1.0, 1.0), uniform(-1.0, 1.0), uniform(0.0, 1.0)]);
        let options = ShadingOptions::default();
        let eye = glam::DVec3::new(0.4, -2.8, 0.9);
        let camera = Camera::look_at(eye, glam::DVec3::ZERO, glam::DVec3::Z, 0.9, size).unwrap();
        Self {
            gaussians,
            prototypes,
            gathered,
            arriving: Vec::new(),
            basis,
            options,
            view: RasterCamera::new(&camera, &options),
        }
    }

    pub(super) fn with_options(mut self, options: ShadingOptions) -> Self {
        self.view.low_pass = options.low_pass;
        self.view.low_pass_compensation = options.low_pass_compensation;
        self.options = options;
        self
    }

    /// Replaces every row of `field`.
    pub(super) fn fill(mut self, field: Field, row: &[f32]) -> Self {
        (0..self.gaussians.len()).for_each(|i| self.gaussians.row_mut(field, i).copy_from_slice(row));
        self
    }

    pub(super) fn source(&self) -> CpuSource<'_> {
        CpuSource {
            gaussians: &self.gaussians,
            prototypes: &self.prototypes,
            options: &self.options,
            gathered: &self.gathered,
            arriving: &self.arriving,
            indirect_basis: &self.basis,
            light: None,
        }
    }

    pub(super) fn cpu(&self, channels: Channels, early_stop: EarlyStop) -> Pass {
        Pass::forward(&self.source(), self.view, channels, early_stop)
    }

    /// The scene in device memory.
    pub(super) fn on_device(&self, gpu: &Gpu) -> AttributeSource {
        let mut measured = self.gathered.as_flattened().to_vec();
        if !self.arriving.is_empty() {
            measured.resize(6 * self.gaussians.len(), 0.0);
            measured.extend(self.arriving.as_flattened());
        }
        AttributeSource {
            layout: LayoutUniform::new(&self.gaussians, &self.options),
            params: gpu.upload("params", &planar(&self.gaussians)).unwrap(),
            globals: gpu.upload("globals", self.prototypes.as_flattened()).unwrap(),
            gathered: (!measured.is_empty()).then(|| gpu.upload("gathered", &measured).unwrap()),
            indirect_basis: Some(gpu.upload("basis", self.basis.as_flattened()).unwrap()),
        }
    }

    /// Projects, lists tiles, computes attributes and blends on the device.
    pub(super) fn gpu<'r>(
        &self,
        raster: &'r mut Raster,
        channels: Channels,
        blending: EarlyStop,
    ) -> Blended<'r> {
        let gpu = raster.gpu.clone();
        let source = self.on_device(&gpu);
        let projected = raster.prepare(&CameraUniform::new(&self.view), &source).unwrap();
        let mut rec = gpu.record();
        let frame = projected.attributes(&mut rec, channels).unwrap();
        let frame = frame.blend(&mut rec, blending).unwrap();
        rec.submit().unwrap();
        frame
    }
}

/// Counts of a frame.
pub(super) fn counts(frame: &Blended<'_>) -> RasterCounts {
    frame.attributed.projected.counts()
}

/// The device's G-buffer as `[pixel][channel]`.
pub(super) fn gbuffer(gpu: &Gpu, frame: &Blended<'_>) -> Vec<Vec<f32>> {
    let (pixels, groups) = (frame.camera().pixels(), groups(frame.attributed.channels));
    let planes = gpu.read(frame.gbuffer(), 0..pixels * groups).unwrap();
    (0..pixels).map(|p| (0..groups).flat_map(|g| planes[g * pixels + p]).collect::<Vec<f32>>()).collect()
}

/// Column `c` of rows.
fn column<T: Copy>(rows: &[Vec<T>], c: usize) -> Vec<T> {
    rows.iter().map(|row| row[c]).collect()
}

/// Largest difference relative to the channel's largest value, and the number of pixels that differ by more than
/// `tolerance`.
///
/// Rounding may move alpha across its threshold of 1/255: such pixels are counted separately, and no pixel may differ by
/// more than two such thresholds.
fn compare(scene: &RasterScene, pass: &Pass, got: &[Vec<f32>], tolerance: f64) -> (f64, usize) {
    let (width, height) = (scene.view.width, scene.view.height);
    let stored = pass.channels.stored();
    let mut scale = vec![1e-6f32; stored];
    for y in 0..height {
        for x in 0..width {
            (0..stored).for_each(|c| scale[c] = scale[c].max(pass.at(x, y, c).abs()));
        }
    }
    let (mut largest, mut cut) = (0.0, 0);
    for y in 0..height {
        for x in 0..width {
            let row = &got[y * width + x];
            let error = worst((0..stored).map(|c| (row[c] - pass.at(x, y, c)).abs() / scale[c]));
            if error < tolerance {
                largest = worst([largest, error]);
            } else {
                cut += 1;
                assert!(error < 0.02, "pixel ({x}, {y}) differs by {error}");
            }
        }
    }
    (largest, cut)
}

/// Asserts parity of the forward pass to `tolerance` in all but one in a thousand pixels.
fn assert_forward(raster: &mut Raster, scene: &RasterScene, channels: Channels, tolerance: f64, name: &str) {
    let gpu = raster.gpu.clone();
    let frame = scene.gpu(raster, channels, EarlyStop::Never);
    let pass = scene.cpu(channels, EarlyStop::Never);
    let (got, counts) = (gbuffer(&gpu, &frame), counts(&frame));
    assert_eq!(counts.visible, pass.splats.len(), "{name}: visible");
    let lists = pass.tiles.splat_of_slot.len();
    assert!(
        counts.instances >= lists && counts.instances <= lists + lists / 100 + 2,
        "{name}: {counts:?} {lists}"
    );
    let (error, cut) = compare(scene, &pass, &got, tolerance);
    eprintln!("{name}: worst {error:e}, {cut} pixels across the cut, {counts:?}");
    assert!(cut * 1000 <= got.len(), "{name}: {cut} pixels differ");
}

#[test]
fn host_and_shaders_agree_on_structs() {
    assert_layout!(SplatRecord as "Splat" in shaders::PROJECT;
        mean, opacity, reach, conic, depth, covariance, compensation, n_tiles, flags, pad_a, pad_b);
    assert_layout!(CameraUniform as "Camera" in shaders::BLEND_4;
        focal, centre_px, rotation, centre, ratio_limits, size, tiles, low_pass, low_pass_compensation, n_pixels, pad);
    assert_layout!(BlendEnd as "BlendEnd" in shaders::BLEND_4; transmittance, slot);
    for (shader, name) in [
        (&shaders::BLEND_4, "Blending"),
        (&shaders::TILE_COUNT, "Ranks"),
        (&shaders::TILE_EMIT, "Emission"),
        (&shaders::TILE_OFFSETS, "TileCounts"),
    ] {
        let layout = shader.layout(name).unwrap();
        assert_eq!((layout.size, layout.members.len()), (size_of::<DispatchParams>(), 4), "{name}");
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn every_channel_set_blends_like_the_cpu() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    for channels in [Channels::Colour, Channels::Geometry, Channels::Material] {
        let scene = RasterScene::random(1, 300, (64, 48), 2);
        assert_forward(&mut raster, &scene, channels, 2e-5, &format!("{channels:?}"));
    }
    for sh_degree in 0..=6 {
        let scene = RasterScene::random(2 + sh_degree as u64, 120, (37, 21), sh_degree);
        let channels = Channels::Full((sh_degree + 1) * (sh_degree + 1));
        assert_forward(&mut raster, &scene, channels, 2e-5, &format!("{channels:?}"));
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn every_shading_form_blends_like_the_cpu() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    for indirect in [IndirectForm::Off, IndirectForm::Learned, IndirectForm::Gathered] {
        for normal in [NormalForm::Free, NormalForm::ShortestAxis] {
            for low_pass_compensation in [false, true] {
                let options =
                    ShadingOptions { indirect, normal, low_pass_compensation, ..ShadingOptions::default() };
                let mut scene = RasterScene::random(11, 200, (48, 33), 1).with_options(options);
                let name = format!("{indirect:?} {normal:?} {low_pass_compensation}");
                assert_forward(&mut raster, &scene, Channels::Full(4), 2e-5, &name);
                scene.gathered.clear();
                assert_forward(&mut raster, &scene, Channels::Full(4), 2e-5, "nothing gathered");
            }
        }
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn the_comparison_notices_a_small_change() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    let mut scene = RasterScene::random(1, 300, (64, 48), 2);
    let pass = scene.cpu(Channels::Material, EarlyStop::Never);
    for (field, by) in [(Field::OpacityLogit, 1e-3), (Field::Mean, 1e-4), (Field::Residual, 1e-3)] {
        let kept = scene.gaussians.clone();
        scene.gaussians.field_mut(field).iter_mut().for_each(|v| *v += by);
        let frame = scene.gpu(&mut raster, Channels::Material, EarlyStop::Never);
        let got = gbuffer(&gpu, &frame);
        let (_, cut) = compare(&scene, &pass, &got, 2e-5);
        assert!(cut * 10 > got.len(), "{field:?}: only {cut} pixels noticed");
        scene.gaussians = kept;
    }
}
