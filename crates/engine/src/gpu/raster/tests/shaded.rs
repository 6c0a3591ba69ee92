//! The light of each Gaussian against the CPU engine.

use super::*;
use crate::cpu::{ROW_HEADER, SurfaceShader};
use crate::gpu::light::{Constants, LightBuffers};
use crate::gpu::shading::Shading;
use crate::gpu::shading::tests::{Noise, random_tables};
use relume_compare::relative_error;
use relume_layout::channel::OutgoingRadiance;
use relume_layout::constants::EarlyStop;
use relume_scene::light::{LightTables, TableLight};
use relume_scene::{DiffuseForm, DisplayRange, IndirectForm, VisibilityForm, sh_count};

/// Results of the forward and backward pass, per drawn Gaussian.
struct Found {
    /// Light to blend and, with all channels, its specular part.
    radiance: Vec<f32>,
    /// Gradients by the splat's position and by the channels.
    rows: Vec<f32>,
    /// Gradient by the tables.
    by_tables: Vec<f32>,
}

impl Found {
    /// Error of each, relative to the largest expected value.
    fn errors(&self, expected: &Found) -> [f64; 3] {
        [
            relative_error(&self.radiance, &expected.radiance),
            relative_error(&self.rows, &expected.rows),
            relative_error(&self.by_tables, &expected.by_tables),
        ]
    }
}

struct ShadedCase {
    scene: RasterScene,
    sh_degree: usize,
    tables: LightTables,
    /// Channels of both passes.
    channels: Channels,
}

impl ShadedCase {
    fn new(seed: u64, sh_degree: usize, options: ShadingOptions, all: bool) -> Self {
        // More than one workgroup; the last one is not full.
        let scene = RasterScene::random(seed, 300, (37, 21), sh_degree).with_options(options);
        let tables = random_tables(&mut Noise::new(seed), sh_degree);
        let channels = if all { Channels::Full(sh_count(sh_degree)) } else { Channels::Material };
        Self { scene, sh_degree, tables, channels }
    }

    /// A random gradient by every pixel's channels, `[pixel][stored]`.
    fn by_gbuffer(&self) -> Vec<Vec<f32>> {
        let mut noise = Noise::new(17);
        let channels = self.channels;
        let mut row = || {
            (0..channels.stored())
                .map(|c| if c < channels.count() { noise.between(-0.5, 0.5) } else { 0.0 })
                .collect()
        };
        (0..self.scene.view.width * self.scene.view.height).map(|_| row()).collect()
    }

    fn on_cpu(&self, drawn: &[usize]) -> Found {
        let (options, range) = (&self.scene.options, DisplayRange::Unit);
        let shader = SurfaceShader { tables: &self.tables, options, sh_degree: self.sh_degree, range };
        let source = self.scene.source().under(shader);
        let pass = Pass::forward(&source, self.scene.view, self.channels, EarlyStop::Never);
        let (count, stored) = (self.channels.count(), self.channels.stored());
        let by = backward::for_cpu(&pass, &self.scene.view, &self.by_gbuffer());
        let width = ROW_HEADER + count;
        let mut rows = pass.splat_gradients(&by, stored, count);
        let mut by_tables = self.tables.zeroed();
        pass.light_backward(&source, &mut rows, width, &mut by_tables);
        let rank = |i: &usize| pass.splats.iter().position(|s| s.gaussian as usize == *i).unwrap();
        let ranks: Vec<usize> = drawn.iter().map(rank).collect();
        let light = |rank: &usize| self.light_of(&pass.attributes[rank * stored..]);
        let row = |rank: &usize| {
            let row = &rows[rank * width..(rank + 1) * width];
            [&row[..2], &row[ROW_HEADER..]].concat()
        };
        Found {
            radiance: ranks.iter().flat_map(light).collect(),
            rows: ranks.iter().flat_map(row).collect(),
            by_tables: by_tables.flat(),
        }
    }

    /// The light in device memory.
    fn shading(&self, gpu: &Gpu) -> Shading {
        Shading {
            options: self.scene.options,
            background: [0.0; 3],
            range: DisplayRange::Unit,
            light: LightBuffers::upload(gpu, &self.tables, self.sh_degree, &[[0.0; 3]; 16]).unwrap(),
            constants: Constants::upload(gpu).unwrap(),
        }
    }

    /// Gaussians that reach a tile, and the device's results for them.
    fn on_gpu(&self, raster: &mut Raster) -> (Vec<usize>, Found) {
        let (gpu, n, groups) = (raster.gpu.clone(), self.scene.gaussians.len(), groups(self.channels));
        let floats = self.tables.flat().len();
        let by_tables = gpu.buffer("by tables", floats).unwrap();
        let by = gpu.upload("by", &backward::planes(&self.by_gbuffer())).unwrap();
        let (shading, camera) = (self.shading(&gpu), CameraUniform::new(&self.scene.view));
        let projected = raster.prepare(&camera, &self.scene.on_device(&gpu)).unwrap();
        let mut rec = gpu.record();
        let frame = projected.attributes(&mut rec, self.channels).unwrap();
        frame.shade(&mut rec, &shading).unwrap();
        let frame = frame.blend(&mut rec, EarlyStop::Never).unwrap();
        let frame = frame.backward(&mut rec, &by, groups).unwrap();
        rec.clear(&by_tables);
        frame.shade_backward(&mut rec, &shading, &by_tables).unwrap();
        rec.submit().unwrap();
        let attributed = &frame.blended.attributed;
        let drawn = drawn(&gpu, &attributed.projected.splats, n);
        let attributes = gpu.read(&attributed.rows, 0..n * groups).unwrap();
        let width = GRADIENT_HEADER + 4 * groups;
        let rows = gpu.read(&frame.splat_gradients, 0..n * width).unwrap();
        let light = |i: &usize| self.light_of(attributes[i * groups..(i + 1) * groups].as_flattened());
        let row = |i: &usize| {
            let row = &rows[i * width..(i + 1) * width];
            [&row[..2], &row[GRADIENT_HEADER..GRADIENT_HEADER + self.channels.count()]].concat()
        };
        let found = Found {
            radiance: drawn.iter().flat_map(light).collect(),
            rows: drawn.iter().flat_map(row).collect(),
            by_tables: gpu.read(&by_tables, 0..floats).unwrap(),
        };
        (drawn, found)
    }

    /// The light in a Gaussian's attribute row.
    fn light_of(&self, row: &[f32]) -> Vec<f32> {
        match self.channels {
            Channels::Full(_) => [&row[OutgoingRadiance::TOTAL], &row[OutgoingRadiance::SPECULAR]].concat(),
            _ => row[OutgoingRadiance::TOTAL].to_vec(),
        }
    }

    fn errors(&self, raster: &mut Raster) -> [f64; 3] {
        let (drawn, found) = self.on_gpu(raster);
        assert!(drawn.len() > 200, "too little to compare: {}", drawn.len());
        found.errors(&self.on_cpu(&drawn))
    }
}

/// Gaussians that reach a tile.
fn drawn(gpu: &Gpu, splats: &Buffer<SplatRecord>, n: usize) -> Vec<usize> {
    let splats = gpu.read(splats, 0..n).unwrap();
    (0..n).filter(|i| splats[*i].flags == 1 && splats[*i].n_tiles > 0).collect()
}

fn assert_small([radiance, rows, by_tables]: [f64; 3], name: &str) {
    assert!(radiance < 2e-5 && rows < 1e-4 && by_tables < 1e-4, "{name}: {radiance} {rows} {by_tables}");
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn shading_at_gaussians_matches_the_cpu_for_every_form() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    for visibility in [VisibilityForm::Linear, VisibilityForm::Sigmoid, VisibilityForm::Off] {
        for diffuse in [DiffuseForm::Directional, DiffuseForm::AmbientOcclusion] {
            let options = ShadingOptions { visibility, diffuse, ..ShadingOptions::default() };
            for all in [false, true] {
                let mut case = ShadedCase::new(3, 2, options, all);
                assert_small(case.errors(&mut raster), &format!("{options:?} {all}"));
                case.scene.gathered.clear();
                assert_small(case.errors(&mut raster), &format!("{options:?} {all}, nothing gathered"));
            }
        }
    }
    for indirect in [IndirectForm::Learned, IndirectForm::Off] {
        let options = ShadingOptions { indirect, ..ShadingOptions::default() };
        assert_small(ShadedCase::new(5, 2, options, true).errors(&mut raster), &format!("{indirect:?}"));
    }
}

/// Three dominant lights; one lies behind most of the surfaces seen.
fn with_lights(mut case: ShadedCase) -> ShadedCase {
    let light = |direction: [f32; 3], radius, irradiance| {
        let direction = glam::Vec3::from(direction).normalize().to_array();
        TableLight { direction, radius, irradiance }
    };
    case.tables.lights = vec![
        light([0.3, -0.8, 0.6], 0.1, [2.0, 1.5, 1.0]),
        light([-0.7, 0.2, 0.5], 0.0, [0.5, 0.7, 0.9]),
        light([0.1, 0.9, -0.4], 0.3, [1.0, 0.2, 0.1]),
    ];
    let mut noise = Noise::new(91);
    let share = |k: usize, v: f32| if k == 1 { 1.0 } else { v };
    case.scene.arriving = (0..case.scene.gaussians.len())
        .map(|_| std::array::from_fn(|k| share(k, noise.between(0.0, 1.0))))
        .collect();
    case
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn shading_with_separate_lights_matches_the_cpu() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    let plain = || ShadedCase::new(3, 2, ShadingOptions::default(), false);
    for all in [false, true] {
        for indirect in [IndirectForm::Gathered, IndirectForm::Off] {
            let options = ShadingOptions { indirect, ..ShadingOptions::default() };
            let case = with_lights(ShadedCase::new(3, 2, options, all));
            assert_small(case.errors(&mut raster), &format!("lights {all} {indirect:?}"));
        }
    }
    // Without a measurement the lights arrive unshadowed.
    let mut open = with_lights(plain());
    open.scene.arriving.clear();
    assert_small(open.errors(&mut raster), "nothing measured");
    let (drawn, found) = with_lights(plain()).on_gpu(&mut raster);
    for (name, other) in [("without lights", plain()), ("unmeasured", open)] {
        let errors = found.errors(&other.on_cpu(&drawn));
        assert!(errors[0] > 1e-2 && errors[1] > 1e-2, "the control, {name}: {errors:?}");
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn colour_only_shading_equals_shading_with_all_rows() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    let case = ShadedCase::new(9, 2, ShadingOptions::default(), false);
    let (drawn, found) = case.on_gpu(&mut raster);
    let n = case.scene.gaussians.len();
    raster.colours = Some(gpu.upload("colours", &vec![[-7.0f32; 4]; n]).unwrap());
    let camera = CameraUniform::new(&case.scene.view);
    let projected = raster.prepare(&camera, &case.scene.on_device(&gpu)).unwrap();
    let mut rec = gpu.record();
    let rows = projected.attributes(&mut rec, Channels::Material).unwrap();
    let shaded = rows.colours(&mut rec, &case.shading(&gpu)).unwrap();
    rec.submit().unwrap();
    let colours = gpu.read(&shaded.rows, 0..n).unwrap();
    let light: Vec<f32> = drawn.iter().flat_map(|i| colours[*i][1..].to_vec()).collect();
    assert!(relative_error(&light, &found.radiance) < 1e-6);
    assert!(drawn.iter().all(|i| colours[*i][0] == 1.0));
    let others = (0..n).filter(|i| !drawn.contains(i));
    assert!(others.map(|i| colours[i]).all(|c| c == [-7.0; 4]), "what is not drawn is left alone");
    let (_, other) = ShadedCase::new(10, 2, ShadingOptions::default(), false).on_gpu(&mut raster);
    let common = light.len().min(other.radiance.len());
    let control = relative_error(&light[..common], &other.radiance[..common]);
    assert!(control > 1e-2, "the control: another scene");
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn shading_at_gaussians_matches_the_cpu_for_every_sh_degree() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    for sh_degree in [0, 1, 3, 4, 5, 6] {
        // A software device needs seconds to compile each of the largest kernels, so each degree above 4
        // tests only one of the two backward kernels.
        for all in [false, true].into_iter().filter(|all| sh_degree < 5 || *all == (sh_degree == 6)) {
            let case = ShadedCase::new(40 + sh_degree as u64, sh_degree, ShadingOptions::default(), all);
            assert_small(case.errors(&mut raster), &format!("order {sh_degree} {all}"));
        }
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn comparison_detects_changed_normals_and_gathered_light() {
    let gpu = Gpu::for_tests();
    let mut raster = Raster::new(&gpu).unwrap();
    let case = || ShadedCase::new(3, 2, ShadingOptions::default(), false);
    let (drawn, found) = case().on_gpu(&mut raster);
    let mut turned = case();
    turned.scene.gaussians.field_mut(Field::Normal).iter_mut().for_each(|v| *v += 0.05);
    let mut brighter = case();
    brighter.scene.gathered.iter_mut().flatten().for_each(|v| *v += 0.05);
    for (name, other) in [("normals", turned), ("gathered", brighter)] {
        let errors = found.errors(&other.on_cpu(&drawn));
        assert!(errors[0] > 1e-3 && errors[1] > 1e-4, "{name}: {errors:?}");
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn shading_without_float_atomics_matches_the_cpu() {
    let options =
        crate::gpu::GpuOptions { compare_exchange: true, garbage: true, checks: true, ..Default::default() };
    let gpu = Gpu::with_options(options);
    let mut raster = Raster::new(&gpu).unwrap();
    assert_small(
        ShadedCase::new(8, 1, ShadingOptions::default(), false).errors(&mut raster),
        "compare-exchange",
    );
}
