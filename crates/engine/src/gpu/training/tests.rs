use std::sync::Arc;

use glam::DVec3;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::training::TrainingEngine as _;
use crate::{
    Branches, ImageWeights, Photo, PhotoId, PhotoLight, PhotoSize, StepCounts, StepSizes, StepWeights,
    TurnedLight,
};
use relume_compare::{largest_difference, relative_error, worst};
use relume_scene::light::TableResolution;
use relume_scene::{Camera, DisplayRange, Field, Gaussians};

const SIZE: u32 = 40;
const GAUSSIANS: usize = 150;

fn model() -> Model {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut gaussians = Gaussians::zeroed(GAUSSIANS, 4, 2, 1);
    for field in Field::ALL {
        let (low, high) = match field {
            Field::LogScale => (-3.0, -1.8),
            Field::Radiance => (-0.5, 0.5),
            Field::SamplingRate => (5.0, 60.0),
            _ => (-1.0, 1.0),
        };
        gaussians.field_mut(field).iter_mut().for_each(|v| *v = rng.random_range(low..high));
    }
    Model::new(gaussians, vec![[0.2, 0.5, 0.7]; 4], vec![[0.3; 3]; 32], (8, 4))
}

fn training(gpu: &Gpu) -> GpuTraining {
    let model = model();
    let sh_degree = model.gaussians.visibility_degree();
    let operators =
        EnvOperators::new(model.env_width, model.env_height, sh_degree, TableResolution::TRAINING);
    let limits = TrainingLimits {
        resolution: SIZE,
        pixels: (SIZE * SIZE) as usize,
        max_gaussians: GAUSSIANS as u32,
        probe_directions: 40,
    };
    GpuTraining::new(gpu, TrainState::new(model), &Arc::new(operators), &limits).unwrap()
}

fn photos() -> Vec<Photo> {
    let photo = |k: i32| {
        let eye = DVec3::new(3.0 * f64::from(k).cos(), 3.0 * f64::from(k).sin(), 0.5);
        let pixel = |i: u32| [0.2 + 0.5 * (i % SIZE) as f32 / SIZE as f32, 0.4, 0.1 * k as f32];
        Photo {
            camera: Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.8, (SIZE, SIZE)).unwrap(),
            pixels: (0..SIZE * SIZE).map(pixel).collect(),
            alpha: Vec::new(),
            light: PhotoLight::default(),
            range: DisplayRange::Unit,
        }
    };
    (0..3).map(photo).collect()
}

fn step(photo: &Photo, index: usize, number: u32) -> Step<'_> {
    let both = ImageWeights { l1: 0.8, ssim: 0.2 };
    Step {
        photo,
        photo_id: PhotoId { index, size: PhotoSize::Full, revision: 0 },
        background: [0.0; 3],
        branches: Branches::Both,
        weights: StepWeights { physical: both, radiance: both, ..Default::default() },
        sizes: StepSizes { fields: [1e-3; Field::COUNT], prototypes: 1e-3, environment: 1e-3 },
        counts: StepCounts { geometry: number, material: number },
    }
}

/// Results of `count` steps.
fn run(training: &mut GpuTraining, count: u32) -> Vec<StepResult> {
    let photos = photos();
    let mut sums = Vec::new();
    for number in 1..=count {
        let index = number as usize % photos.len();
        sums.extend(training.step(&step(&photos[index], index, number)).unwrap());
    }
    sums.extend(training.finish().unwrap());
    sums
}

fn loss_error(found: &StepResult, expected: &StepResult) -> f64 {
    relative_error(&[found.loss], &[expected.loss])
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn every_step_is_reported_once_and_in_order() {
    let gpu = Gpu::for_tests();
    let (mut at_once, mut waiting) = (training(&gpu), training(&gpu));
    let together = run(&mut at_once, 6);
    let photos = photos();
    let mut alone = Vec::new();
    for number in 1..=6 {
        let index = number as usize % photos.len();
        assert_eq!(waiting.step(&step(&photos[index], index, number)).unwrap(), None);
        alone.extend(waiting.finish().unwrap());
    }
    assert_eq!((together.len(), alone.len()), (6, 6));
    for (a, b) in together.iter().zip(&alone) {
        assert!(a.finite && loss_error(a, b) < 1e-4, "{a:?} {b:?}");
    }
    let apart = worst(together.windows(2).map(|w| loss_error(&w[0], &w[1])));
    assert!(apart > 1e-2, "the control: steps differ by {apart}");
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn step_needs_pixels_only_for_photographs_not_on_the_device() {
    let gpu = Gpu::for_tests();
    let (mut training, mut other) = (training(&gpu), training(&gpu));
    let photos = photos();
    let bare = |k: usize| Photo { pixels: Vec::new(), ..photos[k].clone() };
    let id = step(&photos[1], 1, 1).photo_id;
    assert!(!training.holds(id));
    training.step(&step(&photos[1], 1, 1)).unwrap();
    assert!(training.holds(id));
    assert!(!training.holds(PhotoId { revision: 1, ..id }) && !training.holds(PhotoId { index: 0, ..id }));
    training.step(&step(&bare(1), 1, 2)).unwrap();
    for number in 1..=2 {
        other.step(&step(&photos[1], 1, number)).unwrap();
    }
    let sums = [&mut training, &mut other].map(|t| t.finish().unwrap().unwrap());
    assert!(loss_error(&sums[0], &sums[1]) < 1e-4, "{sums:?}");
    assert!(matches!(training.step(&step(&bare(0), 0, 3)), Err(DeviceError::Misuse(_))), "the control");
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn steps_with_too_short_lists_are_repeated() {
    let gpu = Gpu::for_tests();
    let (mut roomy, mut short) = (training(&gpu), training(&gpu));
    short.raster.set_capacity(16);
    let (expected, got) = (run(&mut roomy, 5), run(&mut short, 5));
    assert_eq!(got.len(), expected.len());
    for (a, b) in got.iter().zip(&expected) {
        assert!(loss_error(a, b) < 1e-4, "{a:?} {b:?}");
    }
    let of = |training: &GpuTraining| training.state().unwrap().into_owned();
    let (a, b) = (of(&short), of(&roomy));
    let field = Field::Radiance;
    let moved = largest_difference(model().gaussians.field(field), b.model.gaussians.field(field));
    let apart = largest_difference(a.model.gaussians.field(field), b.model.gaussians.field(field));
    assert!(moved > 2e-3, "the control: five steps move parameters by {moved}");
    assert!(apart < 2e-4, "{apart}");
    assert_eq!(a.density.seen, b.density.seen, "each step counts once");
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn step_with_too_short_lists_changes_no_state() {
    let gpu = Gpu::for_tests();
    let mut training = training(&gpu);
    training.raster.set_capacity(16);
    let before = training.state().unwrap().into_owned();
    let photos = photos();
    for number in 1..3 {
        let step = training.device_step(&step(&photos[0], 0, number)).unwrap();
        training.submit(step).unwrap();
    }
    let state = |training: &GpuTraining| training.state().unwrap().into_owned();
    let now = state(&training);
    assert_eq!(now.model, before.model);
    assert_eq!((now.moments, now.density), (before.moments.clone(), before.density));
    training.raster.set_capacity(1 << 14);
    gpu.write(training.raster.list_status(), 1, &[0]);
    let again = training.device_step(&step(&photos[0], 0, 1)).unwrap();
    training.submit(again).unwrap();
    assert_ne!(state(&training).model, before.model, "the control");
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn step_needs_one_submission_one_wait_and_no_new_bind_group() {
    let gpu = Gpu::with_options(Default::default());
    let mut training = training(&gpu);
    run(&mut training, 4);
    let (before, groups) = (gpu.counts(), gpu.inner.bind_groups.len());
    gpu.inner.counters.take_max_in_flight();
    run(&mut training, 10);
    let spent = gpu.counts() - before;
    assert_eq!((spent.submissions, spent.waits), (10, 10));
    assert!(spent.dispatches <= 10 * 75, "{} dispatches a step", spent.dispatches / 10);
    assert_eq!(gpu.inner.bind_groups.len(), groups);
    assert_eq!(
        gpu.inner.counters.take_max_in_flight(),
        2,
        "a step is recorded while the device is at the one before"
    );
    drop(training);
    gpu.record().submit().unwrap();
    assert_eq!(gpu.inner.bind_groups.len(), 0, "memory that nobody needs is let go of");
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn training_never_queues_more_than_three_submissions_ahead() {
    let gpu = Gpu::with_options(Default::default());
    let mut training = training(&gpu);
    run(&mut training, 2);
    gpu.inner.counters.take_max_in_flight();
    let lights = [0.0, 1.0, 2.0, 3.0].map(|radians| TurnedLight { group: 0, radians });
    let how = ProbeMeasurement {
        directions: 40,
        bounces: 2,
        lights: &lights,
        field: FieldUpdate::Replace,
        repeats: 2,
    };
    let before = gpu.counts();
    training.measure(&how).unwrap();
    let slices = (gpu.counts() - before).submissions;
    assert!(slices > 2 * 40, "a measurement is cut into slices: {slices}");
    assert_eq!(gpu.inner.counters.take_max_in_flight(), 2, "slices that a frame would wait for");
    assert!(training.snapshot().unwrap());
    run(&mut training, 3);
    // Copies of the snapshot precede the first step.
    assert!(gpu.inner.counters.take_max_in_flight() <= 3);
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn state_access_is_refused_while_steps_are_unfinished() {
    let gpu = Gpu::for_tests();
    let mut training = training(&gpu);
    let photos = photos();
    training.step(&step(&photos[0], 0, 1)).unwrap();
    assert!(training.state().is_err() && training.density_signals().is_err() && training.snapshot().is_err());
    training.finish().unwrap();
    assert!(training.state().is_ok(), "the control");
}
