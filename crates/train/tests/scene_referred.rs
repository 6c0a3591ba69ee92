//! Scene-referred photographs: a model of EXR photographs is brighter than white where they are.

use std::sync::Arc;

use relume_capture::{Capture, CaptureView, SyntheticOptions, synthetic};
use relume_engine::{Device, TrainState, evaluation};
use relume_scene::{BitDepth, DisplayRange, ImageRgba, Model, PackedImage, srgb};
use relume_spec::rendering::{Output, Tier};
use relume_spec::training::TrainOverrides;
use relume_train::render::Renderer;

use crate::support::{finish, overrides, trainer};

/// Linear factor that makes the brightest surfaces brighter than white.
const BRIGHTER: f32 = 4.0;
/// Least radiance of a bright pixel, all channels, linear.
const BRIGHT: f32 = 1.5;

/// Photographs of a bright scene, each stored by `store` from its extended display values.
fn capture(store: impl Fn(&ImageRgba) -> PackedImage) -> Capture {
    let options =
        SyntheticOptions { train_views: 10, test_views: 1, size: 40, paths: 16, ..Default::default() };
    let mut capture = synthetic(&options).unwrap();
    for view in &mut capture.train {
        let mut image = view.image.decoded();
        for pixel in &mut image.pixels {
            (0..3).for_each(|c| pixel[c] = srgb::encode_extended(BRIGHTER * srgb::decode(pixel[c])));
        }
        view.image = store(&image);
    }
    capture
}

fn trained(capture: &Capture) -> Model {
    let overrides = TrainOverrides { match_exposures: Some(false), ..overrides(240) };
    let mut trainer = trainer(capture, &overrides, &Device::Cpu);
    finish(&mut trainer);
    trainer.model().unwrap()
}

/// Opaque pixels of a scene-referred photograph that are brighter than white in all channels.
fn bright_pixels(view: &CaptureView) -> Vec<usize> {
    let least = srgb::encode_extended(BRIGHT);
    let is_bright = |p: [f32; 4]| p[3] > 0.99 && p[..3].iter().all(|v| *v > least);
    (0..view.image.len()).filter(|i| is_bright(view.image.pixel(*i))).collect()
}

/// Mean of the channels of these pixels.
fn mean(pixels: &[usize], value: impl Fn(usize) -> [f32; 3]) -> f32 {
    pixels.iter().map(|i| value(*i).iter().sum::<f32>() / 3.0).sum::<f32>() / pixels.len() as f32
}

/// Means over `pixels` of a view: of the radiance branch, display values, and of the physically based branch, linear.
fn shown(model: &Model, view: &CaptureView, pixels: &[usize]) -> [f32; 2] {
    let camera = view.camera.in_normalised_world(model.world_scale, model.world_offset);
    let radiance = evaluation::radiance(&TrainState::new(model.clone()), &camera, [1.0; 3]);
    let renderer = Renderer::on(Arc::new(model.clone()), &Device::Cpu).unwrap();
    let light = renderer.prepare_light(model.recovered_light()).unwrap();
    let frame = renderer.render(&view.camera, &light, Tier::Standard, &[Output::Rgb]).unwrap();
    let shaded = frame.planes[&Output::Rgb].as_chunks::<3>().0;
    [mean(pixels, |i| radiance[i]), mean(pixels, |i| shaded[i])]
}

#[test]
fn model_of_exr_photographs_is_brighter_than_white() {
    let exr = capture(PackedImage::scene_referred);
    let png = capture(|image| PackedImage::new(image, BitDepth::Sixteen));
    let view = &exr.train[0];
    let pixels = bright_pixels(view);
    assert!(pixels.len() >= 20 && view.image.range() == DisplayRange::Extended, "{}", pixels.len());
    let truth = mean(&pixels, |i| {
        let [r, g, b, _] = view.image.pixel(i);
        [r, g, b]
    });
    let [radiance, shaded] = shown(&trained(&exr), view, &pixels);
    assert!((radiance - truth).abs() < 0.5 * (truth - 1.0), "{radiance} of {truth}");
    assert!(shaded > 1.1, "{shaded}");
    let [clipped, _] = shown(&trained(&png), view, &pixels);
    assert!(clipped < 1.05, "the control: {clipped}");
}
