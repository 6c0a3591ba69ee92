//! Zero, one and very many Gaussians, pixels and cameras; and photographs without contrast.

use relume_capture::{Capture, SyntheticOptions, synthetic};
use relume_engine::Device;
use relume_scene::{BitDepth, Camera, Field, ImageRgba, PackedImage};
use relume_spec::training::{Preset, TrainConfig, TrainOverrides};
use relume_train::{TrainError, Trainer};

use glam::DVec3;

use super::harness::{BACKGROUND, Suite, TIGHT, in_front, model, on_each_engine};

on_each_engine! {
    models_with_zero_and_one_gaussian_match,
    one_hundred_thousand_gaussians_in_few_tiles_match,
    images_of_one_pixel_and_of_8192_pixels_match,
    black_white_and_one_pixel_photographs_train,
    two_thousand_photographs_train,
}

fn models_with_zero_and_one_gaussian_match(device: &Device) {
    let mut suite = Suite::on(device);
    let nothing = suite.alike("none", &model(0, 40), &in_front((16, 12)), 0.0);
    assert!(nothing.radiance.iter().chain(&nothing.physical).all(|p| *p == BACKGROUND.map(f64::from)));
    suite.check("one", &model(1, 41), &in_front((16, 12)), TIGHT);
    suite.finish();
}

fn one_hundred_thousand_gaussians_in_few_tiles_match(device: &Device) {
    let mut suite = Suite::on(device);
    let mut many = model(100_000, 42);
    many.gaussians.field_mut(Field::LogScale).iter_mut().for_each(|s| *s -= 2.5);
    many.gaussians.field_mut(Field::OpacityLogit).iter_mut().for_each(|s| *s -= 3.0);
    let result = suite.alike("many", &many, &in_front((20, 18)), 1e-3);
    assert!(result.splats.len() > 20_000);
    suite.finish();
}

fn images_of_one_pixel_and_of_8192_pixels_match(device: &Device) {
    let mut suite = Suite::on(device);
    suite.check("1 x 1", &model(6, 43), &in_front((1, 1)), TIGHT);
    // Strips of 8,192 pixels with a field of view of 90 degrees.
    for (size, fov) in [((8192, 1), 2.0 * (0.5f64 / 4096.0).atan()), ((1, 8192), 0.5 * std::f64::consts::PI)]
    {
        let mut model = model(3, 44);
        (0..3).for_each(|i| model.gaussians.row_mut(Field::Mean, i)[if size.1 == 1 { 2 } else { 0 }] = 0.0);
        let camera = Camera::look_at(DVec3::new(0.0, -3.0, 0.0), DVec3::ZERO, DVec3::Z, fov, size).unwrap();
        suite.check(&format!("{size:?}"), &model, &camera, TIGHT);
    }
    suite.finish();
}

fn capture(views: usize) -> Capture {
    let options = SyntheticOptions {
        train_views: 4,
        test_views: 1,
        size: 16,
        paths: 4,
        relit: Default::default(),
        ..SyntheticOptions::default()
    };
    let mut capture = synthetic(&options).unwrap();
    let made = capture.train.clone();
    capture.train = (0..views).map(|i| made[i % made.len()].clone()).collect();
    capture
}

/// Trains for `steps` steps and returns the last loss.
fn train(capture: &Capture, steps: usize, device: &Device) -> f32 {
    let overrides = TrainOverrides {
        iterations: Some(40),
        resolution: Some(16),
        initial_gaussians: Some(64),
        max_gaussians: Some(64),
        warm_up: Some(0.0),
        probe_directions: Some(8),
        ..TrainOverrides::default()
    };
    let config = TrainConfig::new(Preset::Draft, &overrides).unwrap();
    let mut trainer = Trainer::new(capture, config, device).unwrap();
    let mut loss = f32::NAN;
    for _ in 0..steps {
        let report = trainer.step().unwrap();
        assert_eq!(report.warning, None, "no step may fail");
        loss = report.loss;
    }
    trainer.model().unwrap().check().unwrap();
    loss
}

fn black_white_and_one_pixel_photographs_train(device: &Device) {
    for colour in [[0.0, 0.0, 0.0, 1.0], [1.0, 1.0, 1.0, 1.0], [0.0, 0.0, 0.0, 0.0]] {
        let mut flat = capture(4);
        for view in &mut flat.train {
            let mut image = view.image.decoded();
            image.pixels.fill(colour);
            view.image = PackedImage::new(&image, BitDepth::Eight);
        }
        assert!(train(&flat, 6, device).is_finite(), "{colour:?}");
    }
    let mut tiny = capture(4);
    for view in &mut tiny.train {
        view.camera = view.camera.resized(1, 1);
        let image = ImageRgba { width: 1, height: 1, pixels: vec![[0.4, 0.5, 0.6, 1.0]] };
        view.image = PackedImage::new(&image, BitDepth::Eight);
    }
    assert!(train(&tiny, 6, device).is_finite());
}

#[test]
fn fewer_than_three_photographs_are_refused_with_their_count() {
    let config = TrainConfig::new(Preset::Draft, &TrainOverrides::default()).unwrap();
    for views in [0, 1, 2] {
        let Err(TrainError::Invalid(reason)) = Trainer::new(&capture(views), config.clone(), &Device::Cpu)
        else {
            panic!("{views} photographs must be refused")
        };
        assert!(reason.contains("capture") && reason.contains(&views.to_string()), "{reason}");
    }
}

fn two_thousand_photographs_train(device: &Device) {
    assert!(train(&capture(2000), 3, device).is_finite());
}
