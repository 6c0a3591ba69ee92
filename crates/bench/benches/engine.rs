//! Speed of the CPU engine by stage: full model, 200x200 px, 10,000 Gaussians in the unit ball.
//!
//! `cargo bench -p relume-bench --bench engine` prints medians. Compare rows of one run, not runs on different
//! machines.

#![allow(clippy::unwrap_used, missing_docs)]

use relume_engine::{ProbeSettings, RasterCamera, fibonacci_sphere};
use std::sync::OnceLock;

use divan::{Bencher, black_box};
use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use relume_capture::{Capture, CaptureView, GroundTruthView, SceneBounds};
use relume_engine::cpu::{AttributeSource, BranchImages, Pass, Probes};
use relume_engine::{Device, SurfaceShader};
use relume_layout::channel::Channels;
use relume_layout::constants::EarlyStop;
use relume_scene::light::{EnvOperators, LightTables, TableResolution, rendering_tables};
use relume_scene::{BitDepth, Camera, DisplayRange, EnvMap, Field, Gaussians, ImageRgba, Model, PackedImage};
use relume_spec::rendering::{Output, Tier};
use relume_spec::training::{Preset, TrainConfig, TrainOverrides};
use relume_train::Trainer;
use relume_train::render::Renderer;

const GAUSSIANS: usize = 10_000;
const SIDE: u32 = 200;
const NO_BASIS: [[f32; 3]; 16] = [[0.0; 3]; 16];

fn main() {
    divan::main();
}

/// Gaussians that cover a few pixels, on a wavy sphere; seeded.
fn model() -> &'static Model {
    static MODEL: OnceLock<Model> = OnceLock::new();
    MODEL.get_or_init(|| {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut g = Gaussians::zeroed(GAUSSIANS, 16, 4, 2);
        for (_, _, data) in g.fields_mut() {
            data.iter_mut().for_each(|v| *v = rng.random::<f32>() - 0.5);
        }
        for i in 0..GAUSSIANS {
            let d = DVec3::new(rng.random(), rng.random(), rng.random()) * 2.0 - DVec3::ONE;
            let p = d.normalize_or(DVec3::X) * (0.75 + 0.1 * (5.0 * d.x).sin());
            g.row_mut(Field::Mean, i).copy_from_slice(&p.as_vec3().to_array());
            let s = -4.2 + 0.5 * rng.random::<f32>();
            g.row_mut(Field::LogScale, i).copy_from_slice(&[s, s + 0.3, s - 1.5]);
            g.row_mut(Field::OpacityLogit, i)[0] = 3.0 * rng.random::<f32>();
        }
        Model::new(g, (0..16).map(|k| [k as f32 / 16.0, 0.5, 0.3]).collect(), vec![[0.3; 3]; 512], (32, 16))
    })
}

fn camera(side: u32) -> Camera {
    Camera::look_at(DVec3::new(0.0, -3.2, 1.2), DVec3::ZERO, DVec3::Z, 0.6, (side, side)).unwrap()
}

fn source() -> AttributeSource<'static> {
    let m = model();
    let source = AttributeSource {
        indirect_basis: &NO_BASIS,
        ..AttributeSource::new(&m.gaussians, &m.prototypes, &m.shading)
    };
    source.under(shader())
}

fn view() -> RasterCamera {
    RasterCamera::new(&camera(SIDE), &model().shading)
}

fn operators() -> &'static EnvOperators {
    static OPERATORS: OnceLock<EnvOperators> = OnceLock::new();
    OPERATORS.get_or_init(|| EnvOperators::new(32, 16, 4, TableResolution::TRAINING))
}

fn tables() -> &'static LightTables {
    static TABLES: OnceLock<LightTables> = OnceLock::new();
    TABLES.get_or_init(|| operators().apply(&[[1.0; 3]; 512]))
}

fn shader() -> SurfaceShader<'static> {
    SurfaceShader { tables: tables(), options: &model().shading, sh_degree: 4, range: DisplayRange::Unit }
}

fn full_pass() -> &'static Pass {
    static PASS: OnceLock<Pass> = OnceLock::new();
    PASS.get_or_init(|| Pass::forward(&source(), view(), Channels::Full(25), EarlyStop::WhenSaturated))
}

#[divan::bench]
fn forward_radiance_channels(b: Bencher) {
    b.bench(|| Pass::forward(&source(), view(), Channels::Colour, EarlyStop::WhenSaturated));
}

#[divan::bench]
fn forward_all_channels(b: Bencher) {
    b.bench(|| Pass::forward(&source(), view(), Channels::Full(25), EarlyStop::WhenSaturated));
}

#[divan::bench]
fn shade_view(b: Bencher) {
    b.bench(|| shader().images(full_pass(), [1.0; 3]));
}

#[divan::bench]
fn shade_view_backward(b: Bencher) {
    let n = (SIDE * SIDE) as usize;
    let by = BranchImages { physical: vec![[1e-5; 3]; n], radiance: vec![[1e-5; 3]; n] };
    b.bench(|| shader().images_backward(full_pass(), [1.0; 3], black_box(&by), &[], 16));
}

#[divan::bench(args = [4, 16, 45])]
fn rasterise_backward(b: Bencher, channels: usize) {
    let stored = channels.next_multiple_of(4);
    let gradient = vec![1e-5f32; full_pass().tiles.len() * 256 * stored];
    let mut by_tables = tables().zeroed();
    b.bench_local(|| {
        full_pass().backward(&source(), black_box(&gradient), stored, channels, Some(&mut by_tables))
    });
}

#[divan::bench]
fn environment_tables(b: Bencher) {
    b.bench(|| operators().apply(black_box(&[[1.0; 3]; 512])));
}

#[divan::bench(sample_count = 5)]
fn probes_of_64_directions(b: Bencher) {
    b.bench(|| Probes::measure(&source(), fibonacci_sphere(64), ProbeSettings::default()));
}

fn capture(side: u32) -> Capture {
    let image =
        ImageRgba { width: side, height: side, pixels: vec![[0.5, 0.4, 0.3, 1.0]; (side * side) as usize] };
    let eye = |i: usize| DVec3::new((i as f64).cos() * 3.2, (i as f64).sin() * 3.2, 1.2);
    let view = |i: usize| CaptureView {
        name: format!("view {i}"),
        camera: Camera::look_at(eye(i), DVec3::ZERO, DVec3::Z, 0.6, (side, side)).unwrap(),
        image: PackedImage::new(&image, BitDepth::Eight),
        light_rotation_deg: 0.0,
        light_group: None,
        truth: GroundTruthView::default(),
    };
    Capture {
        layout: "bench".into(),
        train: (0..4).map(view).collect(),
        test: Vec::new(),
        points: model()
            .gaussians
            .field(Field::Mean)
            .chunks_exact(3)
            .map(|p| (DVec3::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2])), [0.5; 3]))
            .collect(),
        bounds: SceneBounds { centre: DVec3::ZERO, radius: 1.0 },
        has_alpha: true,
        lights: Default::default(),
        turntable: None,
        measured_light: None,
        grey_card: None,
        colour_chart: None,
        up: Default::default(),
        warnings: Vec::new(),
    }
}

/// A complete optimisation step: with `warm_up` 1 the radiance branch only, with 0 the full model. Excludes the
/// refresh of probes.
#[divan::bench(args = [1.0, 0.0], sample_count = 60)]
fn training_step(b: Bencher, warm_up: f32) {
    step(b, warm_up, SIDE, GAUSSIANS as u32);
}

/// A step of the full model at the size of a test: 160 Gaussians, 24x24 px.
#[divan::bench(sample_count = 400)]
fn small_training_step(b: Bencher) {
    step(b, 0.0, 24, 160);
}

fn step(b: Bencher, warm_up: f32, side: u32, gaussians: u32) {
    let overrides = TrainOverrides {
        iterations: Some(1_000_000),
        resolution: Some(side),
        initial_gaussians: Some(gaussians),
        max_gaussians: Some(gaussians),
        warm_up: Some(warm_up),
        half_resolution: Some(0.0),
        probe_every: Some(1_000_000),
        ..Default::default()
    };
    let config = TrainConfig::new(Preset::Standard, &overrides).unwrap();
    let mut trainer = Trainer::new(&capture(side), config, &Device::Cpu).unwrap();
    trainer.step().unwrap();
    b.bench_local(|| trainer.step().unwrap());
}

#[divan::bench(args = [Tier::Preview, Tier::Standard])]
fn relit_frame_256(b: Bencher, tier: Tier) {
    let renderer = Renderer::new(model().clone().into());
    let light = renderer.prepare_light(EnvMap::constant(64, 32, [1.0; 3])).unwrap();
    b.bench_local(|| renderer.render(&camera(256), &light, tier, &[Output::Rgb]).unwrap());
}

#[divan::bench(sample_count = 5)]
fn posted_light_1k(b: Bencher) {
    let map = EnvMap::from_fn(1024, 512, |d| [(d.z as f32 + 1.1); 3]);
    b.bench_local(|| rendering_tables(black_box(&map), 4));
}
