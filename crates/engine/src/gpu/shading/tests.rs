//! Shading on the device against the CPU engine, on random G-buffers, so that every pixel has another surface.

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::RasterCamera;
use crate::cpu::{self, AttributeSource, BranchImages, BufferGradient, Pass, SurfaceShader};
use crate::gpu::shaders::assert_layout;
use relume_compare::{largest_difference, worst};
use relume_layout::channel;
use relume_layout::constants::EarlyStop;
use relume_scene::light::{CubeGrid, LightTables};
use relume_scene::{Camera, DiffuseForm, Gaussians, ShadeAt, VisibilityForm, sh_count};

pub(in crate::gpu) struct Noise(ChaCha8Rng);

impl Noise {
    pub(in crate::gpu) fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub(in crate::gpu) fn between(&mut self, lo: f32, hi: f32) -> f32 {
        lo + (hi - lo) * self.0.random::<f32>()
    }

    pub(in crate::gpu) fn rgb(&mut self, lo: f32, hi: f32) -> [f32; 3] {
        std::array::from_fn(|_| self.between(lo, hi))
    }
}

pub(in crate::gpu) fn camera_view(size: (u32, u32), options: &ShadingOptions) -> RasterCamera {
    let eye = glam::DVec3::new(0.4, -2.8, 0.9);
    let camera = Camera::look_at(eye, glam::DVec3::ZERO, glam::DVec3::Z, 0.9, size).unwrap();
    RasterCamera::new(&camera, options)
}

/// A pass whose G-buffer the test overwrites.
pub(in crate::gpu) fn empty_pass(view: RasterCamera, options: &ShadingOptions, channels: Channels) -> Pass {
    let (gaussians, prototypes) = (Gaussians::zeroed(0, 2, 0, 0), [[0.5; 3]; 2]);
    let source = AttributeSource::new(&gaussians, &prototypes, options);
    Pass::forward(&source, view, channels, EarlyStop::WhenSaturated)
}

pub(in crate::gpu) fn set(pass: &mut Pass, x: usize, y: usize, channel: usize, value: f32) {
    let at = pass.locate(x, y, pass.channels.stored()) + channel * 16;
    pass.gbuffer[at] = value;
}

/// A G-buffer of `channels` in `[tile][row][channel][lane]`, converted to the device's layout, with garbage in padding
/// channels.
pub(in crate::gpu) fn planar_gbuffer(pass: &Pass, values: &[f32], channels: Channels) -> Vec<[f32; 4]> {
    let (w, h, stored) = (pass.view.width, pass.view.height, channels.stored());
    let mut out = vec![[f32::NAN; 4]; w * h * stored / 4];
    for i in 0..w * h {
        let base = pass.locate(i % w, i / w, stored);
        for c in 0..channels.count() {
            out[c / 4 * w * h + i][c % 4] = values[base + c * 16];
        }
    }
    out
}

pub(in crate::gpu) fn random_pass(
    noise: &mut Noise,
    size: (u32, u32),
    sh_degree: usize,
    options: &ShadingOptions,
) -> Pass {
    let view = camera_view(size, options);
    let mut pass = empty_pass(view, options, Channels::Full(sh_count(sh_degree)));
    for i in 0..view.width * view.height {
        let (x, y) = (i % view.width, i / view.width);
        let coverage = match i % 7 {
            0 => 0.0,
            1 => 5e-4,
            2 => 1.0,
            _ => noise.between(0.01, 1.0),
        };
        set(&mut pass, x, y, channel::COVERAGE, coverage);
        for c in 1..pass.channels.count() {
            let value = match c {
                1..=3 => noise.between(0.0, 1.0),
                4..=6 => noise.between(-1.0, 1.0),
                channel::ROUGH => noise.between(-0.05, 1.05),
                channel::VISIBILITY => noise.between(0.0, 5.0),
                c if c > channel::VISIBILITY => noise.between(-0.3, 0.3),
                _ => noise.between(0.0, 1.0),
            };
            set(&mut pass, x, y, c, value * coverage);
        }
    }
    pass
}

pub(in crate::gpu) fn random_tables(noise: &mut Noise, sh_degree: usize) -> LightTables {
    let diffuse_grid = CubeGrid::new(5);
    let specular_grids = [9, 7, 5, 5, 4, 3].map(CubeGrid::new);
    let (n, used) = (relume_scene::light::padded(sh_count(sh_degree)), sh_count(sh_degree));
    LightTables {
        diffuse_grid,
        coefficients: n,
        diffuse: (0..diffuse_grid.len() * 3 * n)
            .map(|i| if i % n < used { noise.between(-0.2, 0.4) } else { 0.0 })
            .collect(),
        specular_grids,
        specular: specular_grids.map(|g| (0..g.len()).map(|_| noise.rgb(0.0, 1.2)).collect()),
        lights: Vec::new(),
    }
}

/// Largest difference over the largest expected entry. Expected zeros must be found as zeros: the largest entry counts as at
/// least 1e-20, not 1e-9 as in [`relume_compare::relative_error`]. An expected entry that is not finite is an infinite error.
pub(in crate::gpu) fn error_of_entries(got: &[f32], expected: &[f32]) -> f64 {
    let most = worst(expected.iter().map(|v| v.abs())).max(1e-20);
    if most.is_finite() { largest_difference(got, expected) / most } else { f64::INFINITY }
}

fn rgb_error(got: &[[f32; 4]], expected: &[[f32; 3]]) -> f64 {
    let got: Vec<f32> = got.iter().flat_map(|p| [p[0], p[1], p[2]]).collect();
    error_of_entries(&got, expected.as_flattened())
}

struct ShadingCase {
    gpu: Gpu,
    pass: Pass,
    tables: LightTables,
    options: ShadingOptions,
    sh_degree: usize,
    background: [f32; 3],
    range: DisplayRange,
}

struct Results {
    images: [Vec<[f32; 4]>; 2],
    by_gbuffer: Vec<[f32; 4]>,
    by_tables: Vec<f32>,
}

impl ShadingCase {
    fn new(gpu: &Gpu, seed: u64, size: (u32, u32), sh_degree: usize, options: ShadingOptions) -> Self {
        let mut noise = Noise::new(seed);
        let pass = random_pass(&mut noise, size, sh_degree, &options);
        let tables = random_tables(&mut noise, sh_degree);
        let (background, range) = ([0.2, 0.5, 0.9], DisplayRange::Unit);
        Self { gpu: gpu.clone(), pass, tables, options, sh_degree, background, range }
    }

    fn cpu(&self) -> SurfaceShader<'_> {
        let Self { tables, options, sh_degree, range, .. } = self;
        SurfaceShader { tables, options, sh_degree: *sh_degree, range: *range }
    }

    fn differentiated(&self, all: bool) -> Channels {
        if all { self.pass.channels } else { Channels::Material }
    }

    /// Runs the forward and backward pass on the device.
    fn run(&self, by: &BranchImages, by_buffers: &[BufferGradient], all: bool) -> Results {
        let gpu = &self.gpu;
        let view = CameraUniform::new(&self.pass.view);
        let n = view.pixels();
        let padded = |p: &Vec<[f32; 3]>| p.iter().map(|v| [v[0], v[1], v[2], f32::NAN]).collect::<Vec<_>>();
        let gbuffer = planar_gbuffer(&self.pass, &self.pass.gbuffer, self.pass.channels);
        let gbuffer = gpu.upload("gbuffer", &gbuffer).unwrap();
        let light = LightBuffers::upload(gpu, &self.tables, self.sh_degree, &[[0.0; 3]; 16]).unwrap();
        let constants = Constants::upload(gpu).unwrap();
        let images = Images::new(gpu, n).unwrap();
        let by_images = Images {
            physical: gpu.upload("by physical", &padded(&by.physical)).unwrap(),
            radiance: gpu.upload("by radiance", &padded(&by.radiance)).unwrap(),
        };
        let by_buffers = gpu.upload("by buffers", &packed(by_buffers)).unwrap();
        let groups = self.differentiated(all).stored() / 4;
        let by_gbuffer = gpu.buffer("by gbuffer", n * groups).unwrap();
        let by_tables = gpu.buffer("by tables", light.layout.floats()).unwrap();
        let (options, background, range) = (self.options, self.background, self.range);
        let shading = Shading { options, background, range, light, constants };
        let mut recorder = gpu.record();
        recorder.clear(&by_tables);
        let gradients = ShadeGradients {
            gbuffer: &gbuffer,
            by_images: &by_images,
            by_buffers: &by_buffers,
            by_gbuffer: &by_gbuffer,
            by_tables: &by_tables,
            differentiated: self.differentiated(all),
        };
        match self.options.shade_at {
            ShadeAt::Pixel => {
                shade(&mut recorder, &view, &shading, &gbuffer, &images).unwrap();
                shade_backward(&mut recorder, &view, &shading, &gradients).unwrap();
            }
            ShadeAt::Gaussian => {
                shaded_images(&mut recorder, &view, &shading, &gbuffer, &images);
                shaded_images_backward(&mut recorder, &view, &shading, &gradients);
            }
        }
        recorder.submit().unwrap();
        Results {
            images: [&images.physical, &images.radiance].map(|b| gpu.read(b, 0..n).unwrap()),
            by_gbuffer: gpu.read(&by_gbuffer, 0..n * groups).unwrap(),
            by_tables: gpu.read(&by_tables, 0..by_tables.len()).unwrap(),
        }
    }

    fn gradients(&self, seed: u64) -> (BranchImages, Vec<BufferGradient>) {
        let mut noise = Noise::new(seed);
        let n = self.pass.view.width * self.pass.view.height;
        let mut image = || (0..n).map(|_| noise.rgb(-1.0, 1.0)).collect::<Vec<_>>();
        let by = BranchImages { physical: image(), radiance: image() };
        let by_buffers = (0..n)
            .map(|_| BufferGradient {
                normal: noise.rgb(-1.0, 1.0),
                plane: noise.between(-1.0, 1.0),
                metal: noise.between(-1.0, 1.0),
                rough: noise.between(-1.0, 1.0),
                coverage: noise.between(-1.0, 1.0),
            })
            .collect();
        (by, by_buffers)
    }
}

/// The gradients in the layout of `surface_terms.wgsl`.
pub(in crate::gpu) fn packed(by_buffers: &[BufferGradient]) -> Vec<[f32; 4]> {
    let first = by_buffers.iter().map(|b| [b.normal[0], b.normal[1], b.normal[2], b.plane]);
    first.chain(by_buffers.iter().map(|b| [b.coverage, b.metal, b.rough, f32::NAN])).collect()
}

fn forms() -> Vec<ShadingOptions> {
    let mut out = Vec::new();
    for visibility in [VisibilityForm::Linear, VisibilityForm::Sigmoid, VisibilityForm::Off] {
        for diffuse in [DiffuseForm::Directional, DiffuseForm::AmbientOcclusion] {
            for shade_at in [ShadeAt::Pixel, ShadeAt::Gaussian] {
                let srgb = diffuse == DiffuseForm::Directional;
                let conserves_energy = visibility != VisibilityForm::Sigmoid;
                let default = ShadingOptions::default();
                out.push(ShadingOptions { visibility, diffuse, conserves_energy, shade_at, srgb, ..default });
            }
        }
    }
    out
}

/// Options with shading in the pixel.
fn deferred() -> ShadingOptions {
    ShadingOptions { shade_at: ShadeAt::Pixel, ..Default::default() }
}

/// Errors of images, G-buffer gradient and table gradient of one case.
fn errors(case: &ShadingCase, all: bool) -> [f64; 4] {
    let (by, by_buffers) = case.gradients(99);
    let results = case.run(&by, &by_buffers, all);
    let images = case.cpu().images(&case.pass, case.background);
    let count = case.differentiated(all).count();
    let (by_gbuffer, by_tables) =
        case.cpu().images_backward(&case.pass, case.background, &by, &by_buffers, count);
    let mut expected = planar_gbuffer(&case.pass, &by_gbuffer, case.differentiated(all));
    expected.as_flattened_mut().iter_mut().filter(|v| v.is_nan()).for_each(|v| *v = 0.0);
    [
        rgb_error(&results.images[0], &images.physical),
        rgb_error(&results.images[1], &images.radiance),
        error_of_entries(results.by_gbuffer.as_flattened(), expected.as_flattened()),
        error_of_entries(&results.by_tables, &by_tables.flat()),
    ]
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn shading_matches_the_cpu_engine_for_every_form() {
    let gpu = Gpu::for_tests();
    for (seed, options) in forms().into_iter().enumerate() {
        let case = ShadingCase::new(&gpu, seed as u64, (37, 21), 4, options);
        for all in [false, true] {
            let [physical, radiance, by_gbuffer, by_tables] = errors(&case, all);
            assert!(physical < 2e-5 && radiance < 1e-6, "{options:?}: {physical} {radiance}");
            assert!(by_gbuffer < 1e-4 && by_tables < 1e-4, "{options:?} {all}: {by_gbuffer} {by_tables}");
        }
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn shading_matches_the_cpu_above_white() {
    let gpu = Gpu::for_tests();
    for (shade_at, srgb) in [
        (ShadeAt::Pixel, true),
        (ShadeAt::Gaussian, true),
        (ShadeAt::Pixel, false),
        (ShadeAt::Gaussian, false),
    ] {
        let options = ShadingOptions { shade_at, srgb, ..Default::default() };
        let mut case = ShadingCase::new(&gpu, 17, (20, 12), 2, options);
        // Light that is 30 times as bright, partly above the peak, and as much where Gaussians were shaded before blending.
        case.tables
            .diffuse
            .iter_mut()
            .chain(case.tables.specular.iter_mut().flatten().flatten())
            .for_each(|v| *v *= 30.0);
        if shade_at == ShadeAt::Gaussian {
            for i in 0..240 {
                for c in channel::OutgoingRadiance::TOTAL {
                    let value = case.pass.at(i % 20, i / 20, c);
                    set(&mut case.pass, i % 20, i / 20, c, 90.0 * value);
                }
            }
        }
        case.range = DisplayRange::Extended;
        let [physical, radiance, by_gbuffer, by_tables] = errors(&case, false);
        assert!(physical < 2e-5 && radiance < 1e-6, "{options:?}: {physical} {radiance}");
        assert!(by_gbuffer < 1e-4 && by_tables < 1e-4, "{options:?}: {by_gbuffer} {by_tables}");
        let shown = case.cpu().images(&case.pass, case.background).physical;
        let brightest = worst(shown.iter().flatten().copied());
        assert!(brightest > 2.0, "{brightest}");
        case.range = DisplayRange::Unit;
        let clipped = case.cpu().images(&case.pass, case.background).physical;
        let control = largest_difference(shown.as_flattened(), clipped.as_flattened());
        assert!(control.is_finite() && control > 1.0, "the control: {control}");
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn shading_matches_the_cpu_for_sh_degrees_and_image_sizes() {
    let gpu = Gpu::for_tests();
    for (sh_degree, size) in
        [(0, (1, 1)), (1, (16, 16)), (2, (17, 3)), (3, (33, 16)), (5, (9, 31)), (6, (20, 20))]
    {
        let case = ShadingCase::new(&gpu, 40 + sh_degree as u64, size, sh_degree, deferred());
        // A software device needs seconds to compile each of the largest kernels, so each degree above 4
        // tests only one of the two kernels.
        for all in [false, true].into_iter().filter(|all| sh_degree < 5 || *all == (sh_degree == 6)) {
            let errors = errors(&case, all);
            assert!(errors[0] < 2e-5 && errors[1] < 1e-6, "{sh_degree} {size:?}: {errors:?}");
            assert!(errors[2] < 1e-4 && errors[3] < 1e-4, "{sh_degree} {size:?} {all}: {errors:?}");
        }
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn table_gradients_without_float_atomics_match_the_cpu() {
    let options =
        crate::gpu::GpuOptions { compare_exchange: true, garbage: true, checks: true, ..Default::default() };
    let gpu = Gpu::with_options(options);
    let case = ShadingCase::new(&gpu, 21, (20, 18), 1, deferred());
    let errors = errors(&case, false);
    assert!(errors[2] < 1e-4 && errors[3] < 1e-4, "{errors:?}");
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn comparison_detects_a_small_change_of_any_input() {
    let gpu = Gpu::for_tests();
    let case = ShadingCase::new(&gpu, 7, (12, 9), 2, deferred());
    let (by, by_buffers) = case.gradients(5);
    let images = case.cpu().images(&case.pass, case.background);
    let (_, by_tables) = case.cpu().images_backward(&case.pass, case.background, &by, &by_buffers, 29);
    for channel in 0..29 {
        if channel == channel::PLANE || channel == channel::DEPTH {
            continue;
        }
        let mut changed = ShadingCase::new(&gpu, 7, (12, 9), 2, deferred());
        let value = changed.pass.at(4, 3, channel);
        set(&mut changed.pass, 4, 3, channel, value + 0.02);
        let results = changed.run(&by, &by_buffers, true);
        let seen = worst([
            rgb_error(&results.images[0], &images.physical),
            rgb_error(&results.images[1], &images.radiance),
            error_of_entries(&results.by_tables, &by_tables.flat()),
        ]);
        assert!(seen.is_finite() && seen > 2e-4, "channel {channel}: {seen}");
    }
    let mut options = case.options;
    options.srgb = false;
    let changed = ShadingCase { options, ..ShadingCase::new(&gpu, 7, (12, 9), 2, options) };
    let results = changed.run(&by, &by_buffers, false);
    let seen = rgb_error(&results.images[0], &images.physical);
    assert!(seen.is_finite() && seen > 1e-2, "{seen}");
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn radiance_branch_alone_matches_the_cpu_engine() {
    let gpu = Gpu::for_tests();
    let background = [0.1, 0.7, 0.4];
    for channels in [Channels::Colour, Channels::Geometry] {
        let case = ShadingCase::new(&gpu, 3, (37, 21), 0, deferred());
        let (by, by_buffers) = case.gradients(8);
        let mut pass = empty_pass(case.pass.view, &case.options, channels);
        let (w, h) = (pass.view.width, pass.view.height);
        for i in 0..w * h {
            for c in 0..channels.count() {
                let value = case.pass.at(i % w, i / w, c);
                set(&mut pass, i % w, i / w, c, value);
            }
        }
        let view = CameraUniform::new(&pass.view);
        let gbuffer = gpu.upload("gbuffer", &planar_gbuffer(&pass, &pass.gbuffer, channels)).unwrap();
        let radiance = gpu.buffer("radiance", w * h).unwrap();
        let by_radiance: Vec<[f32; 4]> = by.radiance.iter().map(|v| [v[0], v[1], v[2], f32::NAN]).collect();
        let by_radiance = gpu.upload("by radiance", &by_radiance).unwrap();
        let on_buffers = gpu.upload("by buffers", &packed(&by_buffers)).unwrap();
        let by_gbuffer = gpu.buffer("by gbuffer", w * h * channels.stored() / 4).unwrap();
        let mut recorder = gpu.record();
        radiance_image(&mut recorder, &view, background, &gbuffer, &radiance);
        radiance_image_backward(
            &mut recorder,
            &view,
            background,
            &by_radiance,
            &on_buffers,
            &by_gbuffer,
            channels,
        );
        recorder.submit().unwrap();
        let expected = cpu::radiance_image(&pass, background);
        assert!(rgb_error(&gpu.read(&radiance, 0..w * h).unwrap(), &expected) < 1e-6);
        let count = channels.count();
        let expected = cpu::radiance_image_backward(&pass, background, &by.radiance, &by_buffers, count);
        let expected = planar_gbuffer(&pass, &expected, channels);
        let got = gpu.read(&by_gbuffer, 0..expected.len()).unwrap();
        assert!(error_of_entries(got.as_flattened(), expected.as_flattened()) < 1e-6);
        let other = cpu::radiance_image_backward(&pass, [0.1, 0.7, 0.5], &by.radiance, &by_buffers, count);
        let other = planar_gbuffer(&pass, &other, channels);
        let control = error_of_entries(got.as_flattened(), other.as_flattened());
        assert!(control.is_finite() && control > 1e-3, "must see another background: {control}");
    }
}

#[test]
fn uniforms_are_laid_out_as_the_shaders_read_them() {
    assert_layout!(ShadingUniform as "Shading" in shaders::SHADE_1; background, visibility_form, diffuse_form,
        shade_at, srgb, conserves_energy, peak, pad_b, pad_c);
    assert_layout!(CompositeUniform as "Composite" in shaders::RADIANCE; background, n_pixels, srgb,
        n_groups, peak);
}
