//! Estimates the end of a training from the time of recent steps and the relative cost of the remaining steps.
//!
//! The mean time per step is a poor estimate, because the first steps are cheaper: they have half resolution, no shading and few
//! Gaussians.

use super::{PhotographCost, ScheduleCost, StepCost};
use relume_spec::training::TrainConfig;

/// The estimate, updated after each step.
#[derive(Debug)]
pub struct Eta {
    cost: ScheduleCost,
    step: u32,
    /// Cost of the remaining steps.
    left: f64,
    seen_ms: i64,
    /// Time and cost of recent steps, exponentially weighted.
    recent_ms: f64,
    recent_cost: f64,
    /// Factor by which the weight of past steps decreases per step.
    memory: f64,
}

impl Eta {
    /// An estimate for a training of `config` on `photographs`, of which earlier runs did `step` steps. `now_ms` is any clock, milliseconds.
    pub fn new(config: &TrainConfig, photographs: PhotographCost, step: u32, now_ms: i64) -> Self {
        let cost = ScheduleCost::new(config, photographs, StepCost::RELATIVE);
        let steps = f64::from((config.iterations / 20).clamp(40, 200));
        Self {
            left: left_from(&cost, step),
            cost,
            step,
            seen_ms: now_ms,
            recent_ms: 0.0,
            recent_cost: 0.0,
            memory: 1.0 - 1.0 / steps,
        }
    }

    /// Records that `step` steps are complete.
    pub fn note(&mut self, step: u32, now_ms: i64) {
        // A rollback increases the number of remaining steps.
        let cost = if step > self.step {
            let done: f64 = (self.step..step).map(|step| self.cost.with_events(step)).sum();
            self.left -= done;
            done
        } else {
            self.left = left_from(&self.cost, step);
            self.cost.with_events(self.step)
        };
        self.step = step;
        self.recent_ms = self.recent_ms * self.memory + (now_ms - self.seen_ms).max(0) as f64;
        self.recent_cost = self.recent_cost * self.memory + cost;
        self.seen_ms = now_ms;
    }

    /// Seconds to the end of the training; `None` before the first step.
    pub fn seconds(&self) -> Option<f64> {
        let pace = self.recent_ms / self.recent_cost;
        pace.is_finite().then(|| (pace * self.left / 1e3).max(0.0))
    }
}

/// Cost of a training after `step` steps.
fn left_from(cost: &ScheduleCost, step: u32) -> f64 {
    (step..cost.positions()).map(|step| cost.with_events(step)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_spec::training::{Preset, TrainOverrides};

    /// Milliseconds of every step of a training on a simulated machine with other cost ratios: pixels are cheaper relative to
    /// Gaussians, shading and measurement are more expensive, each step varies slightly, and the machine is busy for a while.
    fn history(config: &TrainConfig, pixels: f64) -> Vec<f64> {
        let warm_up = config.warm_up_steps();
        let step = |i: u32| {
            let share = f64::from(i) / f64::from(config.iterations);
            let pixels = if share < f64::from(config.half_resolution) { pixels / 4.0 } else { pixels };
            let grown = (share / f64::from(config.densify_until)).min(1.0);
            let (low, high) = (f64::from(config.initial_gaussians), f64::from(config.max_gaussians));
            // Density control does not reach its limit.
            let gaussians = low + 0.9 * (high - low) * grown.sqrt();
            let shading = if i < warm_up { 1.0 } else { 2.5 };
            let is_refreshed = i > warm_up && (i - warm_up).is_multiple_of(config.probe_every);
            // A search for lights and a restart of the environment.
            let lights = if config.is_albedo_round(i) { 300.0 } else { 0.0 };
            let compared = if config.is_exposure_round(i) { 35.0 } else { 0.0 };
            // Images for the decisions on the complexity, as steps without shading.
            let decided = if i + 1 == config.iterations { 150.0 } else { 0.0 };
            let shaded = (shading + decided) * (0.3 * pixels + gaussians);
            // Materials begin with two measurements.
            let measurements = 2.0 * f64::from(i == warm_up) + f64::from(is_refreshed);
            let measured = 0.47 * f64::from(config.probe_directions) * measurements;
            let probes = gaussians * (lights + compared + measured);
            let uneven = 1.0 + 0.3 * f64::from(i * 7919 % 11) / 10.0;
            let busy = if (0.5..0.6).contains(&share) { 1.4 } else { 1.0 };
            (5.0 + 0.002 * (shaded + probes)) * uneven * busy
        };
        (0..config.iterations).map(step).collect()
    }

    /// The estimate after `done` steps and the estimate from the mean time per step, each divided by the true value.
    fn over_the_truth(config: &TrainConfig, pixels: f64, done: u32) -> (f64, f64) {
        let history = history(config, pixels);
        let (mut now, mut eta) =
            (1e6, Eta::new(config, PhotographCost { count: 60.0, pixels }, 0, 1_000_000));
        for (i, ms) in (1..=done).zip(&history) {
            now += ms;
            eta.note(i, now as i64);
        }
        let truth: f64 = history[done as usize..].iter().sum::<f64>() / 1e3;
        let naive = (now - 1e6) / 1e3 / f64::from(done) * f64::from(config.iterations - done);
        (eta.seconds().unwrap() / truth, naive / truth)
    }

    #[test]
    fn eta_is_within_a_factor_of_two_after_a_twentieth_of_steps() {
        let short = TrainOverrides { iterations: Some(400), ..TrainOverrides::default() };
        for (config, pixels) in [
            (TrainConfig::preset(Preset::Draft), 160.0 * 120.0),
            (TrainConfig::preset(Preset::Standard), 400.0 * 400.0),
            (TrainConfig::preset(Preset::High), 800.0 * 600.0),
            (TrainConfig::new(Preset::Draft, &short).unwrap(), 100.0 * 100.0),
        ] {
            for percent in [5, 10, 14, 16, 20, 26, 30, 40, 50, 55, 60, 70, 80, 90, 98] {
                let (ours, _) = over_the_truth(&config, pixels, config.iterations * percent / 100);
                assert!((0.5..2.0).contains(&ours), "{:?} at {percent} %: {ours}", config.preset);
            }
            let (ours, naive) = over_the_truth(&config, pixels, config.iterations / 20);
            assert!(
                naive < 0.4,
                "the control: the mean time per step gives {naive} of the true value, not {ours}"
            );
        }
    }

    #[test]
    fn eta_accounts_for_rollbacks_and_resumed_steps() {
        let config = TrainConfig::preset(Preset::Draft);
        let mut eta = Eta::new(&config, PhotographCost { count: 60.0, pixels: 1e4 }, 1000, 0);
        assert_eq!(eta.seconds(), None, "no step was recorded yet");
        for step in 1001..=1100 {
            eta.note(step, i64::from(step - 1000) * 10);
        }
        let before = eta.seconds().unwrap();
        assert!((2.0..8.0).contains(&before), "400 steps of 10 ms are left: {before}");
        eta.note(1050, 1010);
        let after = eta.seconds().unwrap();
        assert!(after > before * 1.05, "450 are: {after}");
        for step in 1051..=1500 {
            eta.note(step, 1010 + i64::from(step - 1050) * 10);
        }
        assert!(eta.seconds().unwrap() < 1e-6, "no steps are left");
    }
}
