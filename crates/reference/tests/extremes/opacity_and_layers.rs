//! Opacity at its limits, and very many layers on one ray.

use relume_compare::worst;
use relume_engine::cpu::{AttributeSource, Pass, backward_labels};
use relume_engine::gpu::raster::{Projected, Raster};
use relume_engine::gpu::{AttributeSource as GpuSource, CameraUniform, Gpu, model::ModelBuffers};
use relume_engine::{Device, RasterCamera};
use relume_layout::channel::{COVERAGE, Channels};
use relume_layout::constants::{EarlyStop, TRANSMITTANCE_STOP};
use relume_reference::{Options, ReferenceModel, TableOperators, Tape, forward, losses};
use relume_scene::{Camera, Field, Model};

use super::harness::{Bounds, ENV, Suite, TABLES, TIGHT, in_front, model, on_each_engine};

on_each_engine! {
    extreme_opacities_match,
    ten_thousand_layers_on_one_ray_match,
    early_stop_error_is_at_most_the_documented_limit,
    backward_labels_match_over_the_whole_ray,
}

const LAYERS: usize = 10_000;
/// Coverage that early stop may miss, plus the last digit of a coverage of 1.
const MAX_MISSED: f32 = TRANSMITTANCE_STOP + f32::EPSILON;

/// Ten thousand sheets behind each other over a single pixel.
fn layered(logit: f32) -> (Model, Camera) {
    let mut model = model(LAYERS, 3);
    for i in 0..LAYERS {
        let depth = (i * 7919 % LAYERS) as f32 / LAYERS as f32 * 2.0 - 1.0;
        model.gaussians.row_mut(Field::Mean, i).copy_from_slice(&[0.0, depth, 0.0]);
        model.gaussians.row_mut(Field::Quaternion, i).copy_from_slice(&[1.0, 0.0, 0.0, 0.0]);
        // Wider than sixteen pixels, which the CPU engine stops together.
        model.gaussians.row_mut(Field::LogScale, i).copy_from_slice(&[8.0, -3.0, 8.0]);
    }
    model.gaussians.field_mut(Field::OpacityLogit).fill(logit);
    (model, in_front((1, 1)))
}

fn extreme_opacities_match(device: &Device) {
    let mut suite = Suite::on(device);
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
        let result = suite.alike(&format!("logit {infinite}"), &model, &in_front((16, 12)), 1e-4);
        assert_eq!(result.splats.iter().any(|s| s.gaussian == 2), infinite > 0.0);
    }
    suite.finish();
}

fn ten_thousand_layers_on_one_ray_match(device: &Device) {
    let mut suite = Suite::on(device);
    // T ends at 1e-8, 1e-175 (below the smallest f32) and 1e-20000.
    for logit in [-5.3, -3.2, 9.0] {
        let (model, camera) = layered(logit);
        // The GPU engine recovers transmittances by division in its backward pass: one last digit per layer is 6e-4.
        let bounds = Bounds { image: 2e-5, gradient: 2e-3 };
        suite.check(&format!("layers of {logit}"), &model, &camera, bounds);
    }
    suite.finish();
}

fn source(model: &Model) -> AttributeSource<'_> {
    AttributeSource::new(&model.gaussians, &model.prototypes, &model.shading)
}

/// The model's splats, projected on the GPU.
fn projected<'r>(raster: &'r mut Raster, gpu: &Gpu, model: &Model, camera: &Camera) -> Projected<'r> {
    let source = GpuSource::new(&ModelBuffers::upload(gpu, model).unwrap());
    let camera = CameraUniform::new(&RasterCamera::new(camera, &model.shading));
    raster.prepare(&camera, &source).unwrap()
}

/// The accumulated alpha of the only pixel.
fn coverage(device: &Device, model: &Model, camera: &Camera, early_stop: EarlyStop) -> f32 {
    let channels = Channels::Full(9);
    let Device::Gpu(gpu) = device else {
        let view = RasterCamera::new(camera, &model.shading);
        return Pass::forward(&source(model), view, channels, early_stop).at(0, 0, COVERAGE);
    };
    let mut raster = Raster::new(gpu).unwrap();
    let mut recorder = gpu.record();
    let frame = projected(&mut raster, gpu, model, camera).attributes(&mut recorder, channels).unwrap();
    let frame = frame.blend(&mut recorder, early_stop).unwrap();
    recorder.submit().unwrap();
    gpu.read(frame.gbuffer(), 0..1).unwrap()[0][0]
}

fn early_stop_error_is_at_most_the_documented_limit(device: &Device) {
    for logit in [-3.2, 0.0, 9.0] {
        let (model, camera) = layered(logit);
        let [whole, stopped] =
            [EarlyStop::Never, EarlyStop::WhenSaturated].map(|stop| coverage(device, &model, &camera, stop));
        let missed = whole - stopped;
        assert!((0.0..=MAX_MISSED).contains(&missed), "{logit}: {missed:e}");
        assert!(missed > 0.0 || logit > 0.0, "the control: something is missed at {logit}");
    }
}

/// Weighted backward transmittance of each Gaussian, with early stop of the forward pass.
fn labels(device: &Device, model: &Model, camera: &Camera) -> Vec<f64> {
    let Device::Gpu(gpu) = device else {
        let view = RasterCamera::new(camera, &model.shading);
        let pass = Pass::forward(&source(model), view, Channels::Full(9), EarlyStop::WhenSaturated);
        let mut found = vec![f64::NAN; LAYERS];
        for (splat, label) in pass.splats.iter().zip(backward_labels(&pass)) {
            found[splat.gaussian as usize] = f64::from(label.transmittance);
        }
        return found;
    };
    let mut raster = Raster::new(gpu).unwrap();
    let mut recorder = gpu.record();
    let labels = projected(&mut raster, gpu, model, camera).backward_labels(&mut recorder).unwrap();
    recorder.submit().unwrap();
    let found = gpu.read(&labels, 0..LAYERS).unwrap();
    found.into_iter().map(|[sum, weight]| f64::from(sum) / f64::from(weight)).collect()
}

fn backward_labels_match_over_the_whole_ray(device: &Device) {
    let (model, camera) = layered(-3.2);
    let tape = Tape::new();
    let options = Options::model(model.shading, TableOperators::new(ENV.0, ENV.1, TABLES));
    let pass = forward(&tape, &ReferenceModel::from_model(&model), &camera, &options);
    let (label, weight) = losses::backward_labels(&pass.weights);
    let (label, weight) = (label.value(), weight.value());
    let found = labels(device, &model, &camera);
    // Labels count from this weight on (docs/MODEL.md section 5).
    let counted: Vec<usize> = (0..LAYERS).filter(|rank| weight.data()[*rank] >= 1e-3).collect();
    let error = |rank: &usize| (found[pass.splats.indices[*rank]] - label.data()[*rank]).abs();
    let worst = worst(counted.iter().map(error));
    eprintln!("{} layers count, worst error {worst:.1e}", counted.len());
    assert!(counted.len() > 50 && worst < 1e-6, "{} {worst:e}", counted.len());
}
