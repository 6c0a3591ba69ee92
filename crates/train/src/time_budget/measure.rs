//! Measures the cost of a training step on a device, with three small trainings of a synthetic scene.

use crate::TrainError;
use crate::time_budget::cost::StepCost;
use crate::trainer::Trainer;
use relume_capture::{Capture, SyntheticOptions, SyntheticScene, synthetic};
use relume_engine::Device;
use relume_spec::training::{Preset, TrainConfig, TrainOverrides};

/// Size of the photographs and number of Gaussians of each training: small, with more pixels, with more Gaussians.
const TRAININGS: [(u32, u32); 3] = [(48, 1_000), (160, 1_000), (48, 8_000)];
/// Steps before the measurement: the first ones include preparations.
const UNMEASURED: u32 = 2;
/// Fewest and most measured steps of a training.
const FEWEST: u32 = 2;
const MOST: u32 = 40;

/// Measures the cost of a step with both branches, seconds. `now` returns the time, seconds; each of the three trainings
/// takes at least two steps and then stops after `limit` seconds.
///
/// # Errors
/// [`TrainError::Device`] if the device failed, [`TrainError::Invalid`] if the clock does not advance.
pub fn step_cost(device: &Device, now: &dyn Fn() -> f64, limit: f64) -> Result<StepCost, TrainError> {
    let mut measured = [(0.0, 0.0, 0.0); 3];
    for (measured, (size, gaussians)) in measured.iter_mut().zip(TRAININGS) {
        let seconds = step_seconds(device, size, gaussians, now, limit)?;
        *measured = (f64::from(size).powi(2), f64::from(gaussians), seconds);
    }
    let stands = || TrainError::Invalid("time_budget_s: the clock of this machine does not advance".into());
    StepCost::through(measured).ok_or_else(stands)
}

/// Mean time of a step on photographs of `size` x `size` pixels, seconds.
fn step_seconds(
    device: &Device,
    size: u32,
    gaussians: u32,
    now: &dyn Fn() -> f64,
    limit: f64,
) -> Result<f64, TrainError> {
    let mut trainer = Trainer::new(&scene(size)?, config(size, gaussians)?, device)?;
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
        probe_directions: Some(8),
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
        let stands = step_cost(&Device::Cpu, &|| 1.0, 0.25).unwrap_err().to_string();
        assert!(stands.contains("does not advance"), "{stands}");
    }
}
