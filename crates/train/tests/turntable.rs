//! Objects that are rotated under a fixed light between photographs: in their own frame the light rotates.

use std::collections::BTreeMap;
use std::sync::OnceLock;

use relume_capture::{Capture, SyntheticOptions, SyntheticScene, synthetic};
use relume_compare::largest_difference;
use relume_engine::Device;
use relume_scene::{EnvMap, Field};
use relume_spec::training::{KnownLight, LightExposure, Preset, TrainConfig, TrainOverrides};
use relume_train::eval::{EvalOptions, evaluate};
use relume_train::{StepReport, TrainError, Trainer};

use relume_reference::gpu_device;

use crate::support::{self, finish, trainer};

/// Rotations of the light in the photographs, degrees: whole and fractional columns of the environment's 32.
const TURNS: [f64; 3] = [0.0, 112.5, 240.0];

/// A light from one side, in the size of the environment.
fn lamp() -> EnvMap {
    EnvMap::from_fn(32, 16, |d| {
        let side = (0.8 * d.x + 0.6 * d.z).max(0.0).powi(8) as f32;
        [0.1 + 7.0 * side, 0.1 + 5.5 * side, 0.12 + 4.0 * side]
    })
}

fn photographs(light: EnvMap) -> Capture {
    let options = SyntheticOptions {
        scene: SyntheticScene::default(),
        train_views: 12,
        test_views: 1,
        size: 40,
        train_light: light,
        relit: BTreeMap::new(),
        paths: 16,
        ..SyntheticOptions::default()
    };
    synthetic(&options).unwrap()
}

/// Photographs with different light rotations; the held-out one has its own rotation.
fn turntable() -> &'static Capture {
    static CAPTURE: OnceLock<Capture> = OnceLock::new();
    CAPTURE.get_or_init(|| {
        let mut sets: Vec<Capture> =
            TURNS.iter().map(|turn| photographs(lamp().rotated_and_scaled(*turn, 1.0))).collect();
        let mut out = sets[0].clone();
        for (i, view) in out.train.iter_mut().enumerate() {
            *view = sets[i % 3].train[i].clone();
            view.light_rotation_deg = TURNS[i % 3];
        }
        out.test = std::mem::take(&mut sets[2].test);
        out.test[0].light_rotation_deg = TURNS[2];
        out
    })
}

fn overrides() -> TrainOverrides {
    support::overrides(240)
}

#[test]
fn light_rotations_of_a_turntable_improve_psnr() {
    let psnr = |used: bool| {
        let overrides = TrainOverrides { light_rotations: Some(used), ..overrides() };
        let mut trainer = trainer(turntable(), &overrides, &Device::Cpu);
        let reports = finish(&mut trainer);
        let last = &reports[reports.len() - 24..];
        let model = std::sync::Arc::new(trainer.model().unwrap());
        let novel = evaluate(model, turntable(), &EvalOptions::default()).unwrap().novel_view.psnr;
        (last.iter().map(|r| r.psnr).sum::<f32>() / 24.0, novel.unwrap())
    };
    let ((with, novel_with), (without, novel_without)) = (psnr(true), psnr(false));
    assert!(with > without + 1.0, "{with} dB with, {without} dB without");
    assert!(novel_with > novel_without + 0.5, "held out: {novel_with} {novel_without}");
}

/// Overrides for the lamp as a known light, rotated by `rotation_deg`; all parameters train from the first
/// step on.
fn known(rotation_deg: f64) -> TrainOverrides {
    let environment = "lamp".to_owned();
    let light = KnownLight { environment, rotation_deg, exposure_ev: LightExposure::default() };
    TrainOverrides { warm_up: Some(0.0), light: Some(light), ..overrides() }
}

/// PSNR of the first two steps under the lamp, dB; later ones depend on rounding, since Adam divides small gradients by their
/// size.
fn first_steps(mut capture: Capture, overrides: &TrainOverrides, device: &Device) -> Vec<f32> {
    capture.measured_light = Some(lamp());
    let mut trainer = trainer(&capture, overrides, device);
    // A device may be one step behind.
    let reports: Vec<StepReport> = (0..3).map(|_| trainer.step().unwrap()).collect();
    let of_step = |n| reports.iter().find(|report| report.metrics_step == n).unwrap().psnr;
    (1..=2).map(of_step).collect()
}

fn assert_photograph_light_rotation_equals_light_rotation(device: &Device) {
    let capture = photographs(lamp());
    let turned = |degrees: f64| {
        let mut capture = capture.clone();
        capture.train.iter_mut().for_each(|view| view.light_rotation_deg = degrees);
        first_steps(capture, &known(0.0), device)
    };
    // Eight columns of 32; the first measurement also gathers light under this rotation.
    let expected = first_steps(capture.clone(), &known(90.0), device);
    let found = turned(90.0);
    let error = largest_difference(&found, &expected);
    assert!(error < 1e-3, "{found:?} {expected:?}");
    let wrong = largest_difference(&turned(-90.0), &expected);
    assert!(wrong.is_finite() && wrong > 0.01, "the control: the other way round, {wrong} dB");
}

#[test]
fn photograph_light_rotation_equals_light_rotation_on_the_cpu() {
    assert_photograph_light_rotation_equals_light_rotation(&Device::Cpu);
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn photograph_light_rotation_equals_light_rotation_on_a_gpu() {
    assert_photograph_light_rotation_equals_light_rotation(gpu_device());
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn rotating_light_trains_equally_on_gpu_and_cpu() {
    let still = TrainOverrides { light_rotations: Some(false), ..known(0.0) };
    let expected = first_steps(turntable().clone(), &known(0.0), &Device::Cpu);
    let found = first_steps(turntable().clone(), &known(0.0), gpu_device());
    assert!(largest_difference(&found, &expected) < 1e-3, "{found:?} {expected:?}");
    let wrong = largest_difference(&first_steps(turntable().clone(), &still, gpu_device()), &expected);
    assert!(wrong.is_finite() && wrong > 0.01, "the control: a light that stands still, {wrong} dB");
    let mean = |device: &Device| {
        let mut trainer = trainer(turntable(), &overrides(), device);
        let reports = finish(&mut trainer);
        reports[216..].iter().map(|r| r.psnr).sum::<f32>() / 24.0
    };
    let (cpu, gpu) = (mean(&Device::Cpu), mean(gpu_device()));
    assert!((cpu - gpu).abs() < 0.5, "{cpu} dB, {gpu} dB");
}

#[test]
fn checkpoint_of_a_still_light_does_not_resume_with_rotations() {
    let overrides = TrainOverrides { warm_up: Some(0.0), ..overrides() };
    let still = photographs(lamp());
    let mut trainer = trainer(&still, &overrides, &Device::Cpu);
    trainer.step().unwrap();
    let (config, checkpoint) = (trainer.config().clone(), trainer.checkpoint().unwrap());
    let resume = |capture: &Capture| Trainer::resume(capture, config.clone(), &checkpoint, &Device::Cpu);
    assert!(resume(&still).is_ok(), "the control");
    let Err(TrainError::Checkpoint(why)) = resume(turntable()) else { panic!("must be refused") };
    assert!(why.contains("light rotations"), "{why}");
}

#[test]
fn training_with_rotating_light_resumes_with_the_same_bytes() {
    let form = TrainOverrides { iterations: Some(60), probe_every: Some(13), ..overrides() };
    let means = |mut trainer: Trainer| {
        finish(&mut trainer);
        let model = trainer.model().unwrap();
        (model.gaussians.field(Field::Mean).to_vec(), model.env_raw)
    };
    let undisturbed = means(trainer(turntable(), &form, &Device::Cpu));
    let mut stopped = trainer(turntable(), &form, &Device::Cpu);
    (0..30).for_each(|_| drop(stopped.step().unwrap()));
    let checkpoint = stopped.checkpoint().unwrap();
    let config = TrainConfig::new(Preset::Draft, &form).unwrap();
    let resumed = Trainer::resume(turntable(), config, &checkpoint, &Device::Cpu).unwrap();
    assert!(means(resumed) == undisturbed);
}

#[test]
fn light_rotations_missing_from_the_capture_are_refused() {
    let mut capture = photographs(lamp());
    let rotations = BTreeMap::from([("train_001/rgba.png".to_owned(), 30.0)]);
    let overrides = TrainOverrides { light_rotation_per_photo: Some(rotations.clone()), ..overrides() };
    let config = TrainConfig::new(Preset::Draft, &overrides).unwrap();
    let refused = Trainer::new(&capture, config.clone(), &Device::Cpu).err();
    let Some(TrainError::Invalid(why)) = refused else { panic!("must be refused: {refused:?}") };
    assert!(why.starts_with("light_rotation_per_photo"), "{why}");
    capture.set_light_rotations(&rotations).unwrap();
    assert!(Trainer::new(&capture, config, &Device::Cpu).is_ok());
}
