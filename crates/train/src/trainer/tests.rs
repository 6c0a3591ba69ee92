use super::*;
use crate::complexity;
use crate::time_budget::{PlanChange, Timeline};
use relume_capture::{SyntheticOptions, synthetic};
use relume_compare::worst;
use relume_reference::gpu_device;
use relume_scene::{Field, Model};
use relume_spec::training::{Preset, TrainOverrides};

#[test]
fn non_finite_step_is_rolled_back_with_lower_rates_on_the_cpu() {
    assert_non_finite_step_is_rolled_back(&Device::Cpu);
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn non_finite_step_is_rolled_back_with_lower_rates_on_a_gpu() {
    assert_non_finite_step_is_rolled_back(gpu_device());
}

/// Three photographs of 24 pixels, and a training of 64 Gaussians with materials from the first step on.
fn small() -> (Capture, TrainConfig) {
    let options = SyntheticOptions {
        train_views: 3,
        test_views: 1,
        size: 24,
        paths: 4,
        relit: Default::default(),
        ..Default::default()
    };
    let overrides = TrainOverrides {
        resolution: Some(24),
        initial_gaussians: Some(64),
        max_gaussians: Some(64),
        warm_up: Some(0.0),
        probe_directions: Some(8),
        ..Default::default()
    };
    let capture = synthetic(&options).unwrap();
    let config = TrainConfig::new(Preset::Draft, &overrides).unwrap();
    (capture, config)
}

fn assert_non_finite_step_is_rolled_back(device: &Device) {
    let (capture, config) = small();
    let mut trainer = Trainer::new(&capture, config, device).unwrap();
    assert_eq!(trainer.step().unwrap().warning, None, "the control: a finite step succeeds");
    let mut state = trainer.engine.state().unwrap().into_owned();
    state.model.env_raw[5] = [f32::NAN; 3];
    trainer.engine.load(state).unwrap();
    assert!(trainer.checkpoint().is_err(), "a poisoned checkpoint must not be written");
    // A device is one step behind.
    let warning = (0..2).find_map(|_| trainer.step().unwrap().warning).unwrap();
    assert!(warning.contains("back to step 0"), "{warning}");
    assert_eq!(trainer.schedule.rate_factor, 0.5);
    assert!(trainer.model().unwrap().check().is_ok());
    assert_eq!(trainer.step().unwrap().warning, None, "training continues");
}

#[test]
fn checkpoint_excludes_a_non_finite_step_on_the_cpu() {
    assert_checkpoint_excludes_a_non_finite_step(&Device::Cpu);
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn checkpoint_excludes_a_non_finite_step_on_a_gpu() {
    assert_checkpoint_excludes_a_non_finite_step(gpu_device());
}

fn assert_checkpoint_excludes_a_non_finite_step(device: &Device) {
    let (capture, config) = small();
    let mut trainer = Trainer::new(&capture, config.clone(), device).unwrap();
    (0..2).for_each(|_| assert_eq!(trainer.step().unwrap().warning, None));
    trainer.wait_for_steps().unwrap();
    let mut state = trainer.engine.state().unwrap().into_owned();
    state.model.env_raw[5] = [f32::NAN; 3];
    trainer.engine.load(state).unwrap();
    // On a device the result is not known yet.
    let known = trainer.step().unwrap().warning;
    let bytes = trainer.checkpoint().unwrap();
    assert_eq!(trainer.progress().step, 0, "the step is rolled back");
    let next = trainer.step().unwrap().warning;
    assert!([known, next].into_iter().flatten().count() == 1, "one warning");
    let mut resumed = Trainer::resume(&capture, config, &bytes, device).unwrap();
    (0..3).for_each(|_| assert_eq!(resumed.step().unwrap().warning, None));
}

/// One field of a small training with `overrides`.
fn learned(field: Field, overrides: TrainOverrides) -> Vec<f32> {
    let options =
        SyntheticOptions { train_views: 3, test_views: 1, size: 24, paths: 4, ..Default::default() };
    let capture = synthetic(&options).unwrap();
    let small = TrainOverrides {
        resolution: Some(24),
        iterations: Some(24),
        initial_gaussians: Some(64),
        max_gaussians: Some(64),
        probe_directions: Some(8),
        ..overrides
    };
    let config = TrainConfig::new(Preset::Draft, &small).unwrap();
    let mut trainer = Trainer::new(&capture, config, &Device::Cpu).unwrap();
    while !trainer.is_done() {
        trainer.step().unwrap();
    }
    trainer.model().unwrap().gaussians.field(field).to_vec()
}

#[test]
fn disabled_metalness_stays_fixed_across_material_restarts() {
    let most = |metalness: bool| {
        let overrides = TrainOverrides { metalness: Some(metalness), ..Default::default() };
        learned(Field::MetalLogit, overrides).into_iter().fold(f32::NEG_INFINITY, f32::max)
    };
    assert_eq!(most(false), complexity::DIELECTRIC);
    assert!(most(true) > complexity::DIELECTRIC, "the control");
}

#[test]
fn sheen_is_learned_unless_disabled() {
    let most = |sheen: bool| {
        let overrides = TrainOverrides { sheen: Some(sheen), ..Default::default() };
        worst(learned(Field::Sheen, overrides).into_iter().map(f32::abs))
    };
    assert_eq!(most(false), 0.0);
    let control = most(true);
    assert!(control.is_finite() && control > 0.0, "the control: {control}");
}

#[test]
fn reduced_model_continues_training_on_the_cpu() {
    assert_reduced_model_continues_training(&Device::Cpu);
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn reduced_model_continues_training_on_a_gpu() {
    assert_reduced_model_continues_training(gpu_device());
}

fn assert_reduced_model_continues_training(device: &Device) {
    let options = SyntheticOptions {
        scene: relume_capture::SyntheticScene::MatteBall,
        train_views: 5,
        test_views: 1,
        size: 24,
        paths: 8,
        relit: Default::default(),
        ..Default::default()
    };
    let capture = synthetic(&options).unwrap();
    let overrides = TrainOverrides {
        resolution: Some(24),
        iterations: Some(24),
        probe_directions: Some(16),
        complexity: Some(relume_spec::training::Complexity::Auto),
        ..Default::default()
    };
    let mut config = TrainConfig::new(Preset::Draft, &overrides).unwrap();
    (config.initial_gaussians, config.max_gaussians) = (128, 160);
    let mut trainer = Trainer::new(&capture, config, device).unwrap();
    while !trainer.is_done() {
        assert_eq!(trainer.step().unwrap().warning, None);
    }
    assert_eq!(trainer.schedule.complexity.due(&trainer.config, 24), None, "all decisions are made");
    let model = trainer.model().unwrap();
    assert!(model.check().is_ok());
    assert_eq!(trainer.operators.sh_degree(), model.gaussians.visibility_degree());
    assert!(model.card["complexity"]["findings"].as_array().unwrap().len() >= 6, "{}", model.card);
}

/// Number of photographs that nine steps on three photographs decode, without a cache.
fn decoded_by_nine_steps(device: &Device) -> u64 {
    let (capture, config) = small();
    let mut trainer = Trainer::new(&capture, config, device).unwrap();
    trainer.data.bound(0);
    let before = trainer.decoding().decoded;
    for _ in 0..9 {
        trainer.step().unwrap();
    }
    trainer.decoding().decoded - before
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn photographs_on_a_gpu_are_decoded_once() {
    assert_eq!(decoded_by_nine_steps(gpu_device()), 3);
    assert_eq!(decoded_by_nine_steps(&Device::Cpu), 9, "the control");
}

#[test]
fn plan_that_jumps_at_a_density_round_repeats_its_bytes() {
    let (capture, config) = small();
    let config = TrainConfig { iterations: 240, max_gaussians: 128, ..config };
    assert!(schedule::density_rounds(&config).contains(64));
    let jump = |total| PlanChange { step: 64, position: 216, total, why: "plateau".to_owned() };
    let mut planned = Trainer::new(&capture, config.clone(), &Device::Cpu).unwrap();
    (0..64).for_each(|_| drop(planned.step().unwrap()));
    planned.replan(jump(88)).unwrap();
    let repeated = |total| {
        let timeline = Timeline::with_changes(240, vec![jump(total)]).unwrap();
        let prepared = PreparedTraining::new(&capture, config.clone()).unwrap().with_timeline(timeline);
        prepared.on(&Device::Cpu).unwrap()
    };
    let finished = |mut trainer: Trainer| {
        while !trainer.is_done() {
            trainer.step().unwrap();
        }
        trainer.model().unwrap().gaussians
    };
    let model = finished(planned);
    assert!(model.len() > 64, "the round has added Gaussians");
    assert!(finished(repeated(88)) == model);
    assert!(finished(repeated(90)) != model, "the control: another plan");
}

#[test]
fn finished_model_hides_gaussians_that_no_photograph_shows() {
    let (capture, mut config) = small();
    config.iterations = 2;
    let mut trainer = Trainer::new(&capture, config, &Device::Cpu).unwrap();
    let mut state = trainer.engine.state().unwrap().into_owned();
    // Far outside of every image.
    state.model.gaussians.row_mut(Field::Mean, 7).copy_from_slice(&[90.0, 0.0, 0.0]);
    trainer.engine.load(state).unwrap();
    let is_hidden = |model: &Model| !model.gaussians.is_photographed(7);
    let preview = trainer.model().unwrap();
    assert!(!is_hidden(&preview), "previews show every Gaussian");
    assert_eq!(preview.gaussians.confidence(), None, "previews have no confidence");
    while !trainer.is_done() {
        trainer.step().unwrap();
    }
    let model = trainer.model().unwrap();
    assert!(is_hidden(&model));
    let confidence = model.gaussians.confidence().unwrap();
    assert!(confidence[7] == 0.0 && confidence.iter().any(|c| *c > 0.1), "{confidence:?}");
    assert!((0..model.gaussians.len()).any(|i| model.gaussians.is_photographed(i)), "the control");
}
