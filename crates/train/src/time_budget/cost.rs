//! The time of steps and events at each position of a schedule.
//!
//! A step with both branches takes `fixed + pixel * pixels + gaussian * Gaussians`. Radiance alone takes a constant
//! share of it. Measurements of the visibility and restarts of the materials are events of their own.

use serde::{Deserialize, Serialize};

use crate::schedule;
use relume_engine::PhotoSize;
use relume_spec::training::TrainConfig;

/// Cost of a pixel, if a Gaussian costs 1. This constant and the next three were measured on the CPU engine; only their ratios
/// matter.
const PIXEL: f64 = 0.45;
/// Cost of a step of both branches relative to a step of the radiance branch.
const SHADED: f64 = 2.25;
/// Cost of one probe of a Gaussian in one direction, relative to a Gaussian in a step of the radiance branch.
const PROBE: f64 = 0.4;
/// Cost of a search for dominant lights relative to one measurement of the visibility.
const LIGHTS: f64 = 5.0;

/// The cost of a step with both branches: `fixed + pixel * pixels + gaussian * Gaussians`, seconds or relative.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StepCost {
    /// Independent of the size.
    pub fixed: f64,
    /// Per pixel of the photograph.
    pub pixel: f64,
    /// Per Gaussian.
    pub gaussian: f64,
}

impl StepCost {
    /// Relative cost on the CPU engine. A Gaussian in a step of the radiance branch is 1.
    pub const RELATIVE: Self = Self { fixed: 0.0, pixel: SHADED * PIXEL, gaussian: SHADED };

    /// The cost through three measured steps of `(pixels, Gaussians, seconds)`: the first small, the second with more
    /// pixels, the third with more Gaussians. Noise may make a coefficient negative; it is then at least a hundredth of
    /// what the ratios of [`Self::RELATIVE`] give. `None` if a measurement is not positive.
    pub fn through([small, pixels, gaussians]: [(f64, f64, f64); 3]) -> Option<Self> {
        let is_positive = |(p, g, s): &(f64, f64, f64)| *p > 0.0 && *g > 0.0 && *s > 0.0 && s.is_finite();
        if ![small, pixels, gaussians].iter().all(is_positive) {
            return None;
        }
        // Seconds per unit of relative cost, if a step had no fixed cost.
        let pace = gaussians.2 / Self::RELATIVE.of(gaussians.0, gaussians.1);
        let slope = |more: f64, time: f64, least: f64| (time / more).max(0.01 * least);
        let pixel = slope(pixels.0 - small.0, pixels.2 - small.2, pace * Self::RELATIVE.pixel);
        let gaussian = slope(gaussians.1 - small.1, gaussians.2 - small.2, pace * Self::RELATIVE.gaussian);
        let fixed = (small.2 - pixel * small.0 - gaussian * small.1).max(0.0);
        Some(Self { fixed, pixel, gaussian })
    }

    /// All coefficients times `factor`.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self { fixed: factor * self.fixed, pixel: factor * self.pixel, gaussian: factor * self.gaussian }
    }

    /// The cost at a size.
    pub fn of(&self, pixels: f64, gaussians: f64) -> f64 {
        self.fixed + self.pixel * pixels + self.gaussian * gaussians
    }
}

/// The cost of each position of a training.
#[derive(Debug, Clone)]
pub struct ScheduleCost {
    config: TrainConfig,
    pixels: f64,
    step: StepCost,
}

impl ScheduleCost {
    /// The cost of a training with `config` on photographs of `pixels` in the mean.
    pub fn new(config: &TrainConfig, pixels: f64, step: StepCost) -> Self {
        Self { config: config.clone(), pixels, step }
    }

    /// Number of positions.
    pub fn positions(&self) -> u32 {
        self.config.iterations
    }

    /// Cost of one optimisation step at a position.
    pub fn step(&self, position: u32) -> f64 {
        let config = &self.config;
        let pixels = match schedule::photo_size(config, position) {
            PhotoSize::Half => self.pixels / 4.0,
            PhotoSize::Full => self.pixels,
        };
        let whole = self.step.of(pixels, self.gaussians(position));
        if position >= config.warm_up_steps() { whole } else { whole / SHADED }
    }

    /// Cost of a step at the end of the schedule.
    pub fn last_step(&self) -> f64 {
        self.step(self.config.iterations.saturating_sub(1))
    }

    /// Cost of the measurements before the step at a position.
    pub fn measurements_before(&self, position: u32) -> f64 {
        let Some(shaded) = self.shaded(position) else { return 0.0 };
        let count = match shaded {
            0 => 2,
            _ => u32::from(shaded.is_multiple_of(self.config.probe_every)),
        };
        f64::from(count) * self.measurement(position)
    }

    /// Cost of the measurement after a step that reaches a position, in a round of density control.
    pub fn measurements_after(&self, position: u32) -> f64 {
        let is_round = schedule::density_rounds(&self.config).contains(position);
        match is_round && self.shaded(position).is_some_and(|shaded| shaded > 0) {
            true => self.measurement(position),
            false => 0.0,
        }
    }

    /// Cost of a restart of the materials before the step at a position: a measurement, and a search for lights.
    pub fn restart(&self, position: u32) -> f64 {
        if self.shaded(position).is_none() || !self.config.is_albedo_round(position) {
            return 0.0;
        }
        let searches = self.config.lights > 0 && self.config.light.is_none();
        self.measurement(position) * (1.0 + if searches { LIGHTS } else { 0.0 })
    }

    /// Steps that train materials so far, if visibility is measured there.
    fn shaded(&self, position: u32) -> Option<u32> {
        let shaded = position.checked_sub(self.config.warm_up_steps());
        shaded.filter(|_| schedule::measures(&self.config))
    }

    /// Cost of one measurement of the visibility.
    fn measurement(&self, position: u32) -> f64 {
        let probes = self.gaussians(position) * f64::from(self.config.probe_directions);
        PROBE / SHADED * self.step.gaussian * probes
    }

    /// Estimated number of Gaussians at a position: growth by density control up to its limit.
    fn gaussians(&self, position: u32) -> f64 {
        let config = &self.config;
        let schedule::DensityRounds { first, last, .. } = schedule::density_rounds(config);
        let share = f64::from(position.min(last).saturating_sub(first))
            / f64::from(last.saturating_sub(first).max(1));
        let (low, high) = (f64::from(config.initial_gaussians), f64::from(config.max_gaussians));
        low + (high - low) * share.sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_spec::training::Preset;

    #[test]
    fn the_cost_through_exact_measurements_is_the_cost() {
        let truth = StepCost { fixed: 0.004, pixel: 2e-7, gaussian: 3e-6 };
        let at = |pixels: f64, gaussians: f64| (pixels, gaussians, truth.of(pixels, gaussians));
        let found = StepCost::through([at(2e3, 1e3), at(2e4, 1e3), at(2e3, 8e3)]).unwrap();
        for (found, truth) in
            [(found.fixed, truth.fixed), (found.pixel, truth.pixel), (found.gaussian, truth.gaussian)]
        {
            assert!((found / truth - 1.0).abs() < 1e-6, "{found} {truth}");
        }
    }

    #[test]
    fn noisy_measurements_give_positive_costs_and_nan_gives_none() {
        let found = StepCost::through([(2e3, 1e3, 0.02), (2e4, 1e3, 0.019), (2e3, 8e3, 0.018)]).unwrap();
        assert!(found.fixed >= 0.0 && found.pixel > 0.0 && found.gaussian > 0.0, "{found:?}");
        for bad in [f64::NAN, 0.0, -1.0, f64::INFINITY] {
            assert_eq!(StepCost::through([(2e3, 1e3, 0.01), (2e4, 1e3, bad), (2e3, 8e3, 0.03)]), None);
        }
    }

    #[test]
    fn events_cost_only_where_the_schedule_has_them() {
        let config = TrainConfig::preset(Preset::Draft);
        let cost = ScheduleCost::new(&config, 1e4, StepCost::RELATIVE);
        let at: Vec<u32> = (0..config.iterations).filter(|p| cost.restart(*p) > 0.0).collect();
        assert_eq!(at, [375 + 112, 375 + 337, 375 + 562]);
        let measured: Vec<u32> =
            (0..config.iterations).filter(|p| cost.measurements_before(*p) > 0.0).collect();
        assert_eq!((measured[0], measured[1], measured.len()), (375, 500, 9));
        let rounds: Vec<u32> = (0..config.iterations).filter(|p| cost.measurements_after(*p) > 0.0).collect();
        assert_eq!((rounds[0], rounds[rounds.len() - 1]), (400, 900));
        assert!(cost.step(300) < cost.step(400), "radiance alone takes less");
    }
}
