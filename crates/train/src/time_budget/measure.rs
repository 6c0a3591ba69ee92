//! Measures the cost of a training step on a device, with three small trainings of a synthetic scene.
//!
//! On a GPU the cost of probes is measured as well. On the CPU engine it has a known ratio to that of a step.

use crate::TrainError;
use std::ops::RangeInclusive;

use crate::time_budget::cost::{ProbeCost, StepCost};
use crate::time_budget::plan::reduced;
use crate::trainer::Trainer;
use relume_capture::{Capture, SyntheticOptions, SyntheticScene, synthetic};
use relume_engine::Device;
use relume_spec::training::{Complexity, Crop, Preset, TrainConfig, TrainOverrides};

/// Size of the photographs and number of Gaussians of each training: small, with more pixels, with more Gaussians.
const TRAININGS: [(u32, u32); 3] = [(48, 1_000), (160, 1_000), (48, 8_000)];
/// Steps before the measurement: the first ones include preparations.
const UNMEASURED: u32 = 2;
/// Fewest and most measured steps of a training.
const FEWEST: u32 = 2;
const MOST: u32 = 40;
/// Directions of a measurement of the visibility if its time does not matter, and if it is timed on photographs.
const UNTIMED_DIRECTIONS: u32 = 8;
const TIMED_DIRECTIONS: u32 = 32;
/// Accepted ratios of the time on photographs to the time on the synthetic scene.
const SCALES: RangeInclusive<f64> = 0.25..=4.0;

/// Longest measurement of each of the three trainings of [`step_cost`] for a time budget; seconds.
pub fn measurement_limit(budget: f64) -> f64 {
    (0.004 * budget).clamp(0.1, 1.0)
}

/// Measures the cost of a step with both branches, seconds. `now` returns the time, seconds; each of the three trainings
/// takes at least two steps and then stops after `limit` seconds.
///
/// # Errors
/// [`TrainError::Device`] if the device failed, [`TrainError::Invalid`] if the clock does not advance.
pub fn step_cost(device: &Device, now: &dyn Fn() -> f64, limit: f64) -> Result<StepCost, TrainError> {
    let mut measured = [(0.0, 0.0, 0.0); 3];
    let mut probes = None;
    for (measured, (size, gaussians)) in measured.iter_mut().zip(TRAININGS) {
        let mut trainer = Trainer::new(&scene(size)?, config(size, gaussians)?, device)?;
        let seconds = seconds_of(&mut trainer, now, limit)?;
        *measured = (f64::from(size).powi(2), f64::from(gaussians), seconds);
        probes = probes_of(&mut trainer, device, now)?;
    }
    let stands = || {
        TrainError::Invalid(
            "time_budget_s: the clock of this machine does not advance; use a preset instead".into(),
        )
    };
    StepCost::through(measured).map(|cost| StepCost { probes, ..cost }).ok_or_else(stands)
}

/// The cost of probes in the state of `trainer`; `None` on the CPU engine.
fn probes_of(
    trainer: &mut Trainer,
    device: &Device,
    now: &dyn Fn() -> f64,
) -> Result<Option<ProbeCost>, TrainError> {
    if device.is_gpu() { trainer.probe_cost(now) } else { Ok(None) }
}

/// `cost`, scaled to steps on the photographs of `capture` at the size and with the Gaussians that `planned` has at its
/// end. The time depends on how Gaussians overlap, which differs between scenes. At least two steps are measured, and then
/// no more after `limit` seconds.
///
/// # Errors
/// As [`step_cost`], and as [`Trainer::new`].
pub fn scaled_cost(
    capture: &Capture,
    planned: &TrainConfig,
    cost: StepCost,
    device: &Device,
    now: &dyn Fn() -> f64,
    limit: f64,
) -> Result<StepCost, TrainError> {
    let config = TrainConfig {
        initial_gaussians: planned.max_gaussians,
        warm_up: 0.0,
        half_resolution: 0.0,
        iterations: 1_000_000,
        probe_directions: if device.is_gpu() { TIMED_DIRECTIONS } else { UNTIMED_DIRECTIONS },
        lights: 0,
        match_exposures: false,
        crop: Crop::NONE,
        complexity: Complexity::Full,
        // The map of a known light is read later.
        light: None,
        grey_card: None,
        colour_chart: None,
        time_budget_s: None,
        until: None,
        ..planned.clone()
    };
    let mut trainer = Trainer::new(capture, config, device)?;
    let gaussians = trainer.model()?.gaussians.len() as f64;
    let seconds = seconds_of(&mut trainer, now, limit)?;
    let sizes: Vec<_> = capture.train.iter().map(|v| (v.image.width, v.image.height)).collect();
    let expected = cost.of(reduced(&sizes, planned.resolution).pixels, gaussians);
    let scaled = cost.scaled((seconds / expected).clamp(*SCALES.start(), *SCALES.end()));
    Ok(StepCost { probes: probes_of(&mut trainer, device, now)?, ..scaled })
}

/// Mean time of a step of `trainer` after its first ones, seconds.
fn seconds_of(trainer: &mut Trainer, now: &dyn Fn() -> f64, limit: f64) -> Result<f64, TrainError> {
    for _ in 0..UNMEASURED {
        trainer.step()?;
    }
    let start = now();
    let mut steps = 0;
    while steps < MOST && (steps < FEWEST || now() - start < limit) {
        trainer.step()?;
        steps += 1;
    }
    // The device may be behind.
    trainer.model()?;
    Ok((now() - start) / f64::from(steps))
}

/// Four views of a scene; their content does not matter.
fn scene(size: u32) -> Result<Capture, TrainError> {
    let options = SyntheticOptions {
        scene: SyntheticScene::MatteBall,
        train_views: 3,
        test_views: 1,
        size,
        paths: 4,
        relit: Default::default(),
        ..SyntheticOptions::default()
    };
    Ok(synthetic(&options)?)
}

/// A training whose steps have all terms, and whose number of Gaussians does not change.
fn config(size: u32, gaussians: u32) -> Result<TrainConfig, TrainError> {
    let overrides = TrainOverrides {
        resolution: Some(size),
        initial_gaussians: Some(gaussians),
        max_gaussians: Some(gaussians),
        warm_up: Some(0.0),
        half_resolution: Some(0.0),
        iterations: Some(1_000_000),
        probe_directions: Some(UNTIMED_DIRECTIONS),
        lights: Some(0),
        ..TrainOverrides::default()
    };
    TrainConfig::new(Preset::Draft, &overrides).map_err(|error| TrainError::Invalid(error.to_string()))
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    #[test]
    fn the_cost_is_measured_with_the_clock_of_the_caller() {
        // Each look at the clock takes a tenth of a second, so every step takes a tenth.
        let time = Cell::new(0.0);
        let now = || {
            time.set(time.get() + 0.1);
            time.get()
        };
        let cost = step_cost(&Device::Cpu, &now, 0.25).unwrap();
        assert!(cost.fixed >= 0.0 && cost.pixel > 0.0 && cost.gaussian > 0.0, "{cost:?}");
        assert!((0.05..0.3).contains(&cost.of(2_304.0, 1_000.0)), "{cost:?}");
        let photographs = scene(48).unwrap();
        let planned = config(48, 200).unwrap();
        let scaled =
            scaled_cost(&photographs, &planned, StepCost::RELATIVE, &Device::Cpu, &now, 0.25).unwrap();
        let ratio = scaled.gaussian / StepCost::RELATIVE.gaussian;
        assert!((ratio - 0.25).abs() < 1e-9, "a tenth of a second is far below the relative cost: {ratio}");
        let stands = step_cost(&Device::Cpu, &|| 1.0, 0.25).unwrap_err().to_string();
        assert!(stands.contains("does not advance"), "{stands}");
    }
}
