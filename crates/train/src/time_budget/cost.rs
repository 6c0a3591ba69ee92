//! The time of steps and events at each position of a schedule.
//!
//! A step with both branches takes `fixed + pixel * pixels + gaussian * Gaussians`. Radiance alone takes a constant
//! share of it. Measurements of the visibility, restarts of the materials and comparisons with all photographs are events of
//! their own.

use serde::{Deserialize, Serialize};

use crate::{complexity, schedule};
use relume_capture::Capture;
use relume_engine::PhotoSize;
use relume_spec::training::TrainConfig;

/// Cost of a pixel, if a Gaussian costs 1. This constant and the next three were measured on the CPU engine; only their ratios
/// matter.
const PIXEL: f64 = 0.45;
/// Cost of a step of both branches relative to a step of the radiance branch.
const SHADED: f64 = 2.25;
/// Cost of one probe of a Gaussian in one direction, relative to a Gaussian in a step of the radiance branch.
const PROBE: f64 = 0.4;
/// Cost of a search for dominant lights per Gaussian, in probes on the host: about 320 tested directions, and the evaluation of the lights.
const SEARCH_PROBES: f64 = 400.0;
/// Cost of a restart of the environment per Gaussian, in probes on the host: 256 directions, and the steps of the solution.
const ENVIRONMENT_PROBES: f64 = 310.0;
/// Cost per Gaussian of comparing one photograph with its render on the host, in probes on the host.
const COMPARISON_PROBES: f64 = 1.25;
/// Cost of rendering one photograph on the host, relative to a step with it on the CPU engine.
const IMAGE: f64 = 0.35;
/// Most pixels of a photograph that decisions render.
const MAX_DECISION_PIXELS: f64 = (complexity::MAX_SIDE * complexity::MAX_SIDE) as f64;

/// Time of one probe, the transmittance from one Gaussian in one direction, seconds or relative.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ProbeCost {
    /// On the device, in a measurement of the visibility.
    pub device: f64,
    /// On all processors of the host, which search for lights and compare photographs.
    pub host: f64,
}

/// The photographs of a training.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PhotographCost {
    /// Number of photographs.
    pub count: f64,
    /// Mean number of pixels of a photograph.
    pub pixels: f64,
}

impl PhotographCost {
    /// The photographs of `capture` that train, at their size in memory.
    pub fn of(capture: &Capture) -> Self {
        let pixels = capture.train.iter().map(|view| view.image.len() as f64).sum::<f64>();
        let count = capture.train.len() as f64;
        Self { count, pixels: pixels / count.max(1.0) }
    }
}

/// The cost of a step with both branches: `fixed + pixel * pixels + gaussian * Gaussians`, seconds or relative.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StepCost {
    /// Independent of the size.
    pub fixed: f64,
    /// Per pixel of the photograph.
    pub pixel: f64,
    /// Per Gaussian.
    pub gaussian: f64,
    /// The cost of probes, if it was measured. Otherwise it has the ratio to `gaussian` that it has on the CPU engine.
    #[serde(default)]
    pub probes: Option<ProbeCost>,
}

impl StepCost {
    /// Relative cost on the CPU engine. A Gaussian in a step of the radiance branch is 1.
    pub const RELATIVE: Self = Self { fixed: 0.0, pixel: SHADED * PIXEL, gaussian: SHADED, probes: None };

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
        Some(Self { fixed, pixel, gaussian, probes: None })
    }

    /// All coefficients times `factor`.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        let probes =
            self.probes.map(|cost| ProbeCost { device: factor * cost.device, host: factor * cost.host });
        let Self { fixed, pixel, gaussian, .. } = *self;
        Self { fixed: factor * fixed, pixel: factor * pixel, gaussian: factor * gaussian, probes }
    }

    /// The cost of probes.
    fn probe(&self) -> ProbeCost {
        let as_on_the_cpu = PROBE / SHADED * self.gaussian;
        self.probes.unwrap_or(ProbeCost { device: as_on_the_cpu, host: as_on_the_cpu })
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
    photographs: PhotographCost,
    step: StepCost,
}

impl ScheduleCost {
    /// The cost of a training with `config` on `photographs`.
    pub fn new(config: &TrainConfig, photographs: PhotographCost, step: StepCost) -> Self {
        Self { config: config.clone(), photographs, step }
    }

    /// Number of positions.
    pub fn positions(&self) -> u32 {
        self.config.iterations
    }

    /// Cost of one optimisation step at a position.
    pub fn step(&self, position: u32) -> f64 {
        let config = &self.config;
        let pixels = match schedule::photo_size(config, position) {
            PhotoSize::Half => self.photographs.pixels / 4.0,
            PhotoSize::Full => self.photographs.pixels,
        };
        let whole = self.step.of(pixels, self.gaussians(position));
        if position >= config.warm_up_steps() { whole } else { whole / SHADED }
    }

    /// Cost of the step at a position, with its events.
    pub fn with_events(&self, position: u32) -> f64 {
        self.step(position)
            + self.measurements(position)
            + self.restart(position)
            + self.comparison(position)
            + self.decisions(position + 1)
    }

    /// Cost of a step at the end of the schedule.
    pub fn last_step(&self) -> f64 {
        self.step(self.config.iterations.saturating_sub(1))
    }

    /// Cost of the measurements before the step at a position.
    pub fn measurements(&self, position: u32) -> f64 {
        let Some(shaded) = self.shaded(position) else { return 0.0 };
        let count = match shaded {
            0 => 2,
            _ => u32::from(shaded.is_multiple_of(self.config.probe_every)),
        };
        f64::from(count) * self.measurement(position)
    }

    /// Cost of a restart of the materials before the step at a position: a measurement, a search for lights, and a restart of the environment.
    pub fn restart(&self, position: u32) -> f64 {
        if self.shaded(position).is_none() || !self.config.is_albedo_round(position) {
            return 0.0;
        }
        let is_unknown = self.config.light.is_none();
        let searches = if self.config.lights > 0 && is_unknown { SEARCH_PROBES } else { 0.0 };
        // Light between surfaces is gathered again without the shadows of the sky.
        let again = if self.config.shading.has_sky_shadows() { self.config.probe_directions } else { 0 };
        let restarts = self.config.environment_restarts && is_unknown;
        let solutions = if restarts { ENVIRONMENT_PROBES + f64::from(again) } else { 0.0 };
        let on_host = (searches + solutions) * self.step.probe().host * self.gaussians(position);
        self.measurement(position) + on_host
    }

    /// Cost of comparing all photographs with renders on the host, before the step at a position: for their exposures, and for
    /// the Gaussians that none of them shows.
    pub fn comparison(&self, position: u32) -> f64 {
        let config = &self.config;
        let rounds = [config.is_exposure_round(position), position == schedule::hiding(config)];
        let count = rounds.into_iter().filter(|is_due| *is_due).count() as f64;
        let views = count * self.photographs.count * self.gaussians(position);
        COMPARISON_PROBES * self.step.probe().host * views
    }

    /// Cost of the renders on the host for decisions on the complexity after a step that reaches a position.
    pub fn decisions(&self, position: u32) -> f64 {
        let photographs = self.photographs.count as usize;
        let count = complexity::state::renders(&self.config, position, photographs) as f64;
        let pace = self.step.probe().host / PROBE;
        let pixels = self.photographs.pixels.min(MAX_DECISION_PIXELS);
        count * IMAGE * pace * StepCost::RELATIVE.of(pixels, self.gaussians(position))
    }

    /// Steps that train materials so far, if visibility is measured there.
    fn shaded(&self, position: u32) -> Option<u32> {
        let shaded = position.checked_sub(self.config.warm_up_steps());
        shaded.filter(|_| schedule::measures(&self.config))
    }

    /// Cost of one measurement of the visibility.
    fn measurement(&self, position: u32) -> f64 {
        self.step.probe().device * self.gaussians(position) * f64::from(self.config.probe_directions)
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
    use relume_spec::training::{Complexity, Preset};

    #[test]
    fn the_cost_through_exact_measurements_is_the_cost() {
        let truth = StepCost { fixed: 0.004, pixel: 2e-7, gaussian: 3e-6, probes: None };
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
        let config = TrainConfig { complexity: Complexity::Full, ..TrainConfig::preset(Preset::Draft) };
        let photographs = PhotographCost { count: 50.0, pixels: 1e4 };
        let cost = ScheduleCost::new(&config, photographs, StepCost::RELATIVE);
        let at: Vec<u32> = (0..config.iterations).filter(|p| cost.restart(*p) > 0.0).collect();
        assert_eq!(at, [375 + 112, 375 + 337, 375 + 562]);
        let measured: Vec<u32> = (0..config.iterations).filter(|p| cost.measurements(*p) > 0.0).collect();
        assert_eq!((measured[0], measured[1], measured.len()), (375, 500, 9));
        assert!(cost.step(300) < cost.step(400), "radiance alone takes less");
        let compared: Vec<u32> = (0..config.iterations).filter(|p| cost.comparison(*p) > 0.0).collect();
        assert_eq!(compared, [375 + 225, 375 + 337, 375 + 450, 375 + 562, 1_200]);
    }

    #[test]
    fn decisions_cost_at_their_steps_and_most_after_the_last_one() {
        let auto = TrainConfig { complexity: Complexity::Auto, ..TrainConfig::preset(Preset::Draft) };
        let full = TrainConfig { complexity: Complexity::Full, ..auto.clone() };
        let photographs = PhotographCost { count: 50.0, pixels: 1e4 };
        let [auto, full] = [&auto, &full].map(|c| ScheduleCost::new(c, photographs, StepCost::RELATIVE));
        let decided: Vec<u32> = (0..=auto.positions()).filter(|p| auto.decisions(*p) > 0.0).collect();
        assert_eq!(decided, [375, 375 + 561, 375 + 562, 1_500]);
        assert!(decided[..3].iter().all(|p| auto.decisions(*p) < 0.5 * auto.decisions(1_500)));
        assert_eq!((0..=full.positions()).map(|p| full.decisions(p)).sum::<f64>(), 0.0, "the control");
    }

    #[test]
    fn measured_probes_replace_the_ratios_of_the_cpu_engine() {
        let config = TrainConfig::preset(Preset::High);
        let at = |probes| {
            let step = StepCost { probes, ..StepCost::RELATIVE };
            let cost = ScheduleCost::new(&config, PhotographCost { count: 80.0, pixels: 1e5 }, step);
            let sum = |of: &dyn Fn(u32) -> f64| (0..config.iterations).map(of).sum::<f64>();
            [sum(&|p| cost.measurements(p)), sum(&|p| cost.restart(p)), sum(&|p| cost.comparison(p))]
        };
        let [usual, slow_device, slow_host] = [
            at(Some(ProbeCost { device: PROBE, host: PROBE })),
            at(Some(ProbeCost { device: 10.0 * PROBE, host: PROBE })),
            at(Some(ProbeCost { device: PROBE, host: 10.0 * PROBE })),
        ];
        assert_eq!(usual, at(None));
        let is = |ratio: f64, expected: f64| (ratio / expected - 1.0).abs() < 1e-9;
        assert!(is(slow_device[0] / usual[0], 10.0) && is(slow_host[0] / usual[0], 1.0));
        assert!(is(slow_device[2] / usual[2], 1.0) && is(slow_host[2] / usual[2], 10.0));
        assert!(slow_device[1] > 2.0 * usual[1] && slow_host[1] > 5.0 * usual[1], "both are in a restart");
    }
}
