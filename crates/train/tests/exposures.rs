//! Photographs whose exposure and white balance differ from one to the next, as those of phones.

use relume_capture::{Capture, SyntheticOptions, synthetic};
use relume_engine::Device;
use relume_scene::{BitDepth, Model, PackedImage, srgb};
use relume_spec::training::{Preset, TrainConfig, TrainOverrides};
use relume_train::Trainer;

use relume_reference::gpu_device;

const VIEWS: usize = 24;

/// Linear gain of photograph `i`: up to a fifth either way, bluer where it is brighter.
fn gain(i: usize) -> [f32; 3] {
    let brightness = 0.4 * ((i * 11 % VIEWS) as f32 / (VIEWS - 1) as f32 - 0.5);
    [brightness, brightness, 1.5 * brightness].map(f32::exp)
}

fn capture(differs: bool) -> Capture {
    let options =
        SyntheticOptions { train_views: VIEWS, test_views: 1, size: 40, paths: 16, ..Default::default() };
    let mut capture = synthetic(&options).unwrap();
    for (i, view) in capture.train.iter_mut().enumerate().filter(|_| differs) {
        let mut image = view.image.decoded();
        for pixel in &mut image.pixels {
            (0..3).for_each(|c| pixel[c] = srgb::encode(gain(i)[c] * srgb::decode(pixel[c])));
        }
        view.image = PackedImage::new(&image, BitDepth::Sixteen);
    }
    capture
}

fn trainer(capture: &Capture, match_exposures: bool, device: &Device) -> Trainer {
    let overrides = TrainOverrides {
        iterations: Some(400),
        resolution: Some(40),
        initial_gaussians: Some(300),
        max_gaussians: Some(600),
        probe_directions: Some(16),
        match_exposures: Some(match_exposures),
        ..Default::default()
    };
    Trainer::new(capture, TrainConfig::new(Preset::Draft, &overrides).unwrap(), device).unwrap()
}

fn finished(mut trainer: Trainer) -> Model {
    while !trainer.is_done() {
        trainer.step().unwrap();
    }
    trainer.model().unwrap()
}

/// Root mean square by which the card's gains differ from the true ones, in logarithms and up to their mean; and that of the
/// true ones from their mean.
fn error_of_gains(model: &Model, capture: &Capture) -> (f32, f32) {
    let mut logs: Vec<[f32; 2]> = Vec::new();
    for (i, view) in capture.train.iter().enumerate() {
        let found = &model.card["exposures"]["gains"][&view.name];
        for c in 0..3 {
            let (found, truth) = (found[c].as_f64().unwrap() as f32, gain(i)[c]);
            logs.push([truth.ln() - found.ln(), truth.ln()]);
        }
    }
    let deviation = |k: usize| {
        let mean: [f32; 3] =
            std::array::from_fn(|c| logs.iter().skip(c).step_by(3).map(|l| l[k]).sum::<f32>() / VIEWS as f32);
        let squares = logs.iter().enumerate().map(|(i, l)| (l[k] - mean[i % 3]).powi(2));
        (squares.sum::<f32>() / logs.len() as f32).sqrt()
    };
    (deviation(0), deviation(1))
}

fn assert_photograph_gains_are_estimated(device: &Device) {
    let capture = capture(true);
    let model = finished(trainer(&capture, true, device));
    let (error, spread) = error_of_gains(&model, &capture);
    assert!(error < 0.4 * spread, "{error} of {spread}");
}

#[test]
fn photograph_gains_are_estimated_on_the_cpu() {
    assert_photograph_gains_are_estimated(&Device::Cpu);
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn photograph_gains_are_estimated_on_a_gpu() {
    assert_photograph_gains_are_estimated(gpu_device());
}

#[test]
fn equal_exposures_or_disabled_matching_leave_photos_unchanged() {
    let of = |differs: bool, matched: bool| finished(trainer(&capture(differs), matched, &Device::Cpu));
    assert!(of(false, true).card["exposures"].is_null());
    assert!(of(true, false).card["exposures"].is_null());
    assert!(of(true, true).card["exposures"]["spread"]["green"].as_f64().unwrap() > 0.05, "the control");
}

#[test]
fn resumed_training_keeps_the_exposure_gains() {
    let capture = capture(true);
    let mut first = trainer(&capture, true, &Device::Cpu);
    let config = first.config().clone();
    while first.progress().step < 200 {
        first.step().unwrap();
    }
    let resumed = Trainer::resume(&capture, config, &first.checkpoint().unwrap(), &Device::Cpu).unwrap();
    let (whole, resumed) = (finished(first), finished(resumed));
    assert!(!whole.card["exposures"].is_null());
    assert_eq!(whole.gaussians, resumed.gaussians);
    assert_eq!(whole.card["exposures"], resumed.card["exposures"]);
}
