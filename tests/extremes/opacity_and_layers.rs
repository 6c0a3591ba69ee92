//! Opacity at its ends, and very many layers on one ray.

use relume::engine::RasterCamera;
use relume::engine::channel::{COVERAGE, Channels};
use relume::engine::constants::{EarlyStop, TRANSMITTANCE_STOP};
use relume::engine::cpu::{AttributeSource, Pass, backward_labels};
use relume::engine::gpu::{AttributeSource as GpuSource, CameraUniform, Raster, model::ModelBuffers};
use relume::engine::reference::{Options, ReferenceModel, TableOperators, Tape, forward, losses};
use relume::scene::{Camera, Field, Model};

use super::harness::{Bounds, ENV, Suite, TABLES, TIGHT, gpu, in_front, model};

const LAYERS: usize = 10_000;
/// What early stop may miss, and the last digit of a coverage of 1.
const MOST_MISSED: f32 = TRANSMITTANCE_STOP + f32::EPSILON;

/// Ten thousand sheets behind each other over a single pixel.
fn layered(logit: f32) -> (Model, Camera) {
    let mut model = model(LAYERS, 3);
    for i in 0..LAYERS {
        let depth = (i * 7919 % LAYERS) as f32 / LAYERS as f32 * 2.0 - 1.0;
        model.gaussians.row_mut(Field::Mean, i).copy_from_slice(&[0.0, depth, 0.0]);
        model.gaussians.row_mut(Field::Quaternion, i).copy_from_slice(&[1.0, 0.0, 0.0, 0.0]);
        // Wider than sixteen pixels, which is what the CPU engine gives up together.
        model.gaussians.row_mut(Field::LogScale, i).copy_from_slice(&[8.0, -3.0, 8.0]);
    }
    model.gaussians.field_mut(Field::OpacityLogit).fill(logit);
    (model, in_front((1, 1)))
}

#[test]
fn opacity_from_nothing_to_everything_and_beyond() {
    let mut suite = Suite::default();
    for compensation in [false, true] {
        for logit in [-1e4, -90.0, -20.0, -5.4, -3.0, 0.0, 4.5, 4.7, 20.0, 90.0, 1e4] {
            let mut model = model(8, 2);
            model.shading.low_pass_compensation = compensation;
            model.gaussians.field_mut(Field::OpacityLogit)[1..7].fill(logit);
            suite.check(&format!("logit {logit}"), &model, &in_front((16, 12)), TIGHT);
        }
    }
    for infinite in [f32::NEG_INFINITY, f32::INFINITY] {
        let mut model = model(8, 2);
        model.gaussians.field_mut(Field::OpacityLogit)[1..4].fill(infinite);
        let answer = suite.alike(&format!("logit {infinite}"), &model, &in_front((16, 12)), 1e-4);
        assert_eq!(answer.splats.iter().any(|s| s.gaussian == 2), infinite > 0.0);
    }
    suite.finish();
}

#[test]
fn ten_thousand_layers_on_one_ray() {
    let mut suite = Suite::default();
    // T ends at 1e-8, 1e-175 (below the smallest f32) and 1e-20000.
    for logit in [-5.3, -3.2, 9.0] {
        let (model, camera) = layered(logit);
        // The GPU engine finds transmittances on its way back by division: a last digit a layer is 6e-4.
        let bounds = Bounds { image: 2e-5, gradient: 2e-3 };
        suite.check(&format!("layers of {logit}"), &model, &camera, bounds);
    }
    suite.finish();
}

fn source(model: &Model) -> AttributeSource<'_> {
    AttributeSource {
        gaussians: &model.gaussians,
        prototypes: &model.prototypes,
        options: &model.shading,
        gathered: &[],
        indirect_basis: &[[0.0; 3]; 16],
        light: None,
    }
}

#[test]
fn early_stop_misses_less_weight_than_it_says() {
    for logit in [-3.2, 0.0, 9.0] {
        let (model, camera) = layered(logit);
        let view = RasterCamera::new(&camera, &model.shading);
        let pass = |early| Pass::forward(&source(&model), view, Channels::Full(9), early);
        let (whole, stopped) = (pass(EarlyStop::Never), pass(EarlyStop::WhenSaturated));
        let missed = whole.at(0, 0, COVERAGE) - stopped.at(0, 0, COVERAGE);
        assert!((0.0..=MOST_MISSED).contains(&missed), "cpu {logit}: {missed:e}");
        assert!(missed > 0.0 || logit > 0.0, "the control: something is missed at {logit}");
        let Some(gpu) = gpu() else { continue };
        let on_gpu = |early| {
            let buffers = ModelBuffers::upload(gpu, &model).unwrap();
            let mut raster = Raster::new(gpu).unwrap();
            let (camera, source) = (CameraUniform::new(&view), GpuSource::new(&buffers));
            let projected = raster.prepare(&camera, &source).unwrap();
            let mut recorder = gpu.record();
            let blending = if early { EarlyStop::WhenSaturated } else { EarlyStop::Never };
            let frame = projected.attributes(&mut recorder, Channels::Full(9)).unwrap();
            let frame = frame.blend(&mut recorder, blending).unwrap();
            recorder.submit().unwrap();
            gpu.read(frame.gbuffer(), 0..1).unwrap()[0][0]
        };
        let missed = on_gpu(false) - on_gpu(true);
        assert!((0.0..=MOST_MISSED).contains(&missed), "gpu {logit}: {missed:e}");
    }
}

#[test]
fn backward_transmittance_is_taken_to_the_end_of_the_ray_whatever_stops_early() {
    let (model, camera) = layered(-3.2);
    let tape = Tape::new();
    let options = Options::model(model.shading, TableOperators::new(ENV.0, ENV.1, TABLES));
    let pass = forward(&tape, &ReferenceModel::from_model(&model), &camera, &options);
    let (label, weight) = losses::backward_labels(&pass.weights);
    let (label, weight) = (label.value(), weight.value());
    let view = RasterCamera::new(&camera, &model.shading);
    let stopped = Pass::forward(&source(&model), view, Channels::Full(9), EarlyStop::WhenSaturated);
    let found = backward_labels(&stopped);
    let mut by_gaussian = vec![(0.0, 0.0); LAYERS];
    for (splat, l) in stopped.splats.iter().zip(&found) {
        by_gaussian[splat.gaussian as usize] = (l.transmittance, l.weight);
    }
    let on_gpu = gpu().map(|gpu| {
        let buffers = ModelBuffers::upload(gpu, &model).unwrap();
        let mut raster = Raster::new(gpu).unwrap();
        let (camera, source) = (CameraUniform::new(&view), GpuSource::new(&buffers));
        let mut projected = raster.prepare(&camera, &source).unwrap();
        let mut recorder = gpu.record();
        let labels = projected.backward_labels(&mut recorder).unwrap();
        recorder.submit().unwrap();
        gpu.read(&labels, 0..LAYERS).unwrap()
    });
    let (mut worst, mut worst_on_gpu, mut counted) = (0.0f64, 0.0f64, 0);
    for (rank, gaussian) in pass.splats.indices.iter().enumerate() {
        // Labels count from this weight on (docs/MODEL.md section 5).
        if weight.data()[rank] < 1e-3 {
            continue;
        }
        counted += 1;
        let expected = label.data()[rank];
        worst = worst.max((f64::from(by_gaussian[*gaussian].0) - expected).abs());
        if let Some(labels) = &on_gpu {
            let [sum, weight] = labels[*gaussian].map(f64::from);
            worst_on_gpu = worst_on_gpu.max((sum / weight - expected).abs());
        }
    }
    eprintln!("That of {counted} layers: cpu {worst:.1e}, gpu {worst_on_gpu:.1e}");
    assert!(counted > 50 && worst < 1e-6 && worst_on_gpu < 1e-6, "{counted} {worst:e} {worst_on_gpu:e}");
}
