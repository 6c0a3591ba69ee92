//! Decides from a figure on held-out photographs when a training may stop.

use relume_spec::training::{TrainConfig, Until, UntilFigure};

/// Checks per training.
const CHECKS: u32 = 20;
/// Number of last checks in which a plateau has no gain: a tenth of the schedule.
const PLATEAU_CHECKS: usize = 2;
/// Share of the schedule that is always completed, with falling step sizes.
pub const LAST_TENTH: f64 = 0.1;

/// Why a training stops.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Stop {
    /// The condition is met by this value.
    Met(f64),
    /// The last tenth of the schedule gained only this much.
    Plateau(f64),
}

/// The figure so far, and when it is measured next.
#[derive(Debug, Clone)]
pub struct Watch {
    until: Until,
    /// Positions between two checks.
    every: u32,
    next: u32,
    /// Position from which a plateau counts: no Gaussians are added and no materials restart any more.
    settled: u32,
    /// Position after which a stop would save nothing.
    last: u32,
    /// Values since `settled`.
    values: Vec<Option<f64>>,
}

impl Watch {
    /// The watch of a training that continues at `position`.
    pub fn new(until: Until, config: &TrainConfig, position: u32) -> Self {
        let positions = config.iterations;
        let every = (positions / CHECKS).max(1);
        let restart = (0..positions).rev().find(|p| config.is_albedo_round(*p)).unwrap_or(0);
        let settled = restart.max((config.densify_until * positions as f32) as u32);
        // The first check is after the first steps of the materials.
        let first = config.warm_up_steps() + every;
        let next = first.max(position.div_ceil(every) * every);
        let last = (f64::from(positions) * (1.0 - LAST_TENTH)) as u32;
        Self { until, every, next, settled, last, values: Vec::new() }
    }

    /// The condition.
    pub fn until(&self) -> Until {
        self.until
    }

    /// Whether the figure is measured at this position.
    pub fn is_due(&self, position: u32) -> bool {
        position >= self.next && position < self.last
    }

    /// Number of checks that are still to come.
    pub fn left(&self, position: u32) -> u32 {
        self.last.saturating_sub(position.max(self.next)).div_ceil(self.every)
    }

    /// Records the value at a position; `None` or NaN if it could not be measured. Returns a reason to stop.
    pub fn note(&mut self, position: u32, value: Option<f64>) -> Option<Stop> {
        self.next = (position / self.every + 1) * self.every;
        let value = value.filter(|value| value.is_finite());
        if self.until.is_met(value) {
            return value.map(Stop::Met);
        }
        if position < self.settled {
            return None;
        }
        self.values.push(value);
        plateau(&self.values, least_gain(self.until.figure)).map(Stop::Plateau)
    }
}

/// Gain in a tenth of the schedule below which a training stops.
fn least_gain(figure: UntilFigure) -> f64 {
    match figure {
        UntilFigure::NovelViewPsnr => 0.02,
        UntilFigure::NovelViewSsim => 2e-4,
    }
}

/// The gain of the last checks over all earlier ones, if it is below `least`. `None` also if one of the last checks
/// has no value, or no earlier one has.
fn plateau(values: &[Option<f64>], least: f64) -> Option<f64> {
    let (earlier, last) = values.split_at(values.len().saturating_sub(PLATEAU_CHECKS));
    if last.len() < PLATEAU_CHECKS || last.iter().any(Option::is_none) {
        return None;
    }
    let best = |values: &[Option<f64>]| values.iter().flatten().copied().reduce(f64::max);
    let gain = best(last)? - best(earlier)?;
    (gain < least).then_some(gain)
}

/// The reason for the model card and the user, e.g. `plateau: 0.01 dB in the last tenth`.
pub fn reason(until: Until, stop: Stop) -> String {
    let unit = |value: f64| match until.figure {
        UntilFigure::NovelViewPsnr => format!("{value:.2} dB"),
        UntilFigure::NovelViewSsim => format!("{value:.4}"),
    };
    match stop {
        Stop::Met(value) => format!("{until} is met: {}", unit(value)),
        Stop::Plateau(gain) => format!("plateau: {} in the last tenth", unit(gain)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_spec::training::Preset;

    fn watch(until: &str) -> Watch {
        Watch::new(until.parse().unwrap(), &TrainConfig::preset(Preset::Draft), 0)
    }

    #[test]
    fn checks_are_spread_over_the_steps_with_materials() {
        let mut watch = watch("novel_view.psnr>=30");
        let mut at = Vec::new();
        for position in 0..1_500 {
            if watch.is_due(position) {
                at.push(position);
                assert_eq!(watch.note(position, None), None);
            }
        }
        assert_eq!((at[0], at[1], at.len()), (450, 525, 12));
        assert_eq!(at[at.len() - 1], 1_275);
        let fresh = Watch::new(watch.until(), &TrainConfig::preset(Preset::Draft), 0);
        assert!(fresh.is_due(1_349) && !fresh.is_due(1_350), "the last tenth is completed anyway");
        let resumed =
            Watch::new("novel_view.psnr>=30".parse().unwrap(), &TrainConfig::preset(Preset::Draft), 601);
        assert!(!resumed.is_due(674) && resumed.is_due(675));
    }

    #[test]
    fn a_met_condition_stops_at_once() {
        let mut watch = watch("novel_view.psnr>=30");
        assert_eq!(watch.note(450, Some(29.99)), None);
        assert_eq!(watch.note(525, Some(f64::NAN)), None, "NaN meets nothing");
        assert_eq!(watch.note(600, Some(30.5)), Some(Stop::Met(30.5)));
        let until = watch.until();
        assert_eq!(reason(until, Stop::Met(30.5)), "novel_view.psnr>=30 is met: 30.50 dB");
        assert_eq!(reason(until, Stop::Plateau(0.018)), "plateau: 0.02 dB in the last tenth");
    }

    #[test]
    fn a_plateau_counts_only_after_the_last_restart() {
        let stop_of = |values: &[f64], from: u32| {
            let mut watch = watch("novel_view.psnr>=99");
            let mut noted = values.iter().enumerate();
            noted.find_map(|(k, value)| watch.note(from + 75 * k as u32, Some(*value)))
        };
        let flat = [25.0, 25.01, 25.0, 25.015];
        assert_eq!(stop_of(&flat, 450), None, "materials restart there");
        let Some(Stop::Plateau(gain)) = stop_of(&flat, 975) else { panic!("must stop") };
        assert!((gain - 0.01).abs() < 1e-9, "{gain}");
        assert_eq!(stop_of(&[25.0, 25.03, 25.06, 25.09, 25.12], 975), None, "the control: it still gains");
    }

    #[test]
    fn a_plateau_needs_finite_values() {
        let flat = [Some(25.0), Some(25.0), Some(25.0)];
        assert_eq!(plateau(&flat, 0.02), Some(0.0), "the control");
        assert_eq!(plateau(&[Some(25.0), None, Some(25.0)], 0.02), None);
        assert_eq!(plateau(&[None, Some(25.0), Some(25.0)], 0.02), None);
        assert_eq!(plateau(&flat[1..], 0.02), None, "nothing to compare with");
        assert_eq!(plateau(&[Some(26.0), Some(25.0), Some(25.5)], 0.02), Some(-0.5));
        let mut watch = watch("novel_view.psnr>=99");
        let values = [25.0, f64::NAN, 25.0, f64::NAN, 25.0];
        assert!(
            values.into_iter().enumerate().all(|(k, v)| watch.note(975 + 75 * k as u32, Some(v)).is_none())
        );
    }
}
