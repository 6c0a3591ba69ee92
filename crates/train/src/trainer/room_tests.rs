//! The light of the surroundings in a training.

use super::*;
use relume_capture::{SyntheticOptions, SyntheticScene, synthetic};
use relume_reference::gpu_device;
use relume_scene::{BitDepth, PackedImage, softplus};
use relume_spec::training::{Preset, TrainOverrides};

/// Photographs of a matte ball in a grey room with a white wall at +x.
fn in_a_room() -> Capture {
    let options = SyntheticOptions {
        scene: SyntheticScene::MatteBall,
        train_views: 12,
        test_views: 1,
        size: 32,
        paths: 8,
        relit: Default::default(),
        ..Default::default()
    };
    let mut capture = synthetic(&options).unwrap();
    for view in &mut capture.train {
        let mut image = view.image.decoded();
        let width = image.width;
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            let ray = view.camera.ray(i as u32 % width, i as u32 / width).normalize();
            let wall = if ray.x > 0.9 { 1.0 } else { 0.5 };
            let [r, g, b, a] = *pixel;
            let over = [r, g, b].map(|v| v * a + wall * (1.0 - a));
            *pixel = [over[0], over[1], over[2], 1.0];
        }
        view.image = PackedImage::new(&image, BitDepth::Sixteen);
    }
    capture.has_alpha = false;
    capture
}

fn config(surrounding_light: bool) -> TrainConfig {
    let overrides = TrainOverrides {
        resolution: Some(32),
        iterations: Some(120),
        warm_up: Some(0.5),
        half_resolution: Some(0.0),
        initial_gaussians: Some(800),
        max_gaussians: Some(1_000),
        probe_directions: Some(8),
        surrounding_light: Some(surrounding_light),
        ..Default::default()
    };
    TrainConfig::new(Preset::Draft, &overrides).unwrap()
}

/// Radiance of the held texels, green.
fn held_radiance(trainer: &Trainer) -> Vec<f32> {
    let state = trainer.engine.state().unwrap();
    let squares = &state.moments.globals[1][state.model.prototypes.len()..];
    let held = state.model.env_raw.iter().zip(squares).filter(|(_, square)| square[0] > 1e10);
    held.map(|(raw, _)| softplus(raw[1])).collect()
}

/// Completes a training; returns its checkpoint after 70 steps.
fn complete(trainer: &mut Trainer) -> Vec<u8> {
    let mut checkpoint = Vec::new();
    while !trainer.is_done() {
        assert_eq!(trainer.step().unwrap().warning, None);
        if trainer.progress().step == 70 {
            checkpoint = trainer.checkpoint().unwrap();
        }
    }
    checkpoint
}

#[test]
fn photographed_surroundings_are_the_light_also_after_a_resume() {
    let capture = in_a_room();
    let mut whole = Trainer::new(&capture, config(true), &Device::Cpu).unwrap();
    let checkpoint = complete(&mut whole);
    let surroundings = whole.schedule.surroundings.clone().unwrap();
    let model = whole.model().unwrap();
    assert_eq!(model.card["light"]["surroundings"], surroundings.card());
    let held = held_radiance(&whole);
    // After so few steps the room is blurred, but brighter than the shaded ball and darker than its white wall.
    assert!(!held.is_empty() && held.iter().all(|v| (0.1..0.8).contains(v)), "{held:?}");
    let mut resumed = Trainer::resume(&capture, config(true), &checkpoint, &Device::Cpu).unwrap();
    complete(&mut resumed);
    assert_eq!(model, resumed.model().unwrap());
    let mut trained = Trainer::new(&capture, config(false), &Device::Cpu).unwrap();
    complete(&mut trained);
    assert_eq!(
        (trained.schedule.surroundings.clone(), held_radiance(&trained)),
        (None, Vec::new()),
        "the control"
    );
}

#[test]
fn texels_of_the_surroundings_are_held_on_the_cpu() {
    assert_texels_of_the_surroundings_are_held(&Device::Cpu);
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn texels_of_the_surroundings_are_held_on_a_gpu() {
    assert_texels_of_the_surroundings_are_held(gpu_device());
}

fn assert_texels_of_the_surroundings_are_held(device: &Device) {
    let mut trainer = Trainer::new(&in_a_room(), config(true), device).unwrap();
    complete(&mut trainer);
    let surroundings = trainer.schedule.surroundings.clone().unwrap();
    let state = trainer.engine.state().unwrap().into_owned();
    let mut again = state.clone();
    surroundings.hold(&mut again);
    let moved = relume_compare::largest_difference(
        state.model.env_raw.as_flattened(),
        again.model.env_raw.as_flattened(),
    );
    assert!(moved < 1e-5, "{moved}");
    let first = state.model.prototypes.len();
    let trained = state.moments.globals[1][first..].iter().filter(|v| v[0] > 0.0 && v[0] < 1e10).count();
    assert!(trained > 0, "the control: sources train");
}
