//! Chooses pixels, Gaussians and steps for a time budget, as a position on the curve of presets.

use crate::time_budget::cost::{PhotographCost, ScheduleCost, StepCost};
use relume_spec::training::{CURVE, ConfigError, TrainConfig, TrainOverrides};

/// Most steps, as a share of the steps of the position. More steps gain little; the planner uses them only at the upper
/// end of the curve, or if the photographs are small.
const MOST_STEPS: f64 = 20.0;
/// Distance between two positions that are tried.
const STRIDE: f32 = 0.025;
/// Fewest steps of any plan.
const FEWEST: u32 = 60;

/// Photographs of these sizes, with the longest side reduced to `resolution`.
pub fn reduced(sizes: &[(u32, u32)], resolution: u32) -> PhotographCost {
    let pixels = |&(width, height): &(u32, u32)| {
        let longest = f64::from(width.max(height)).max(1.0);
        let scale = (f64::from(resolution) / longest).min(1.0);
        f64::from(width) * f64::from(height) * scale * scale
    };
    let count = sizes.len() as f64;
    PhotographCost { count, pixels: sizes.iter().map(pixels).sum::<f64>() / count.max(1.0) }
}

/// Seconds that a training of `photographs` takes with the work after its last step, by the cost of its steps.
pub fn seconds(config: &TrainConfig, photographs: PhotographCost, cost: StepCost, finish_steps: f64) -> f64 {
    let cost = ScheduleCost::new(config, photographs, cost);
    (0..config.iterations).map(|p| cost.with_events(p)).sum::<f64>() + finish_steps * cost.last_step()
}

/// `config` with the number of steps that fills `left` seconds, for these photographs: at least 60 steps, at most 20 times
/// those of `config`.
pub fn with_steps_for(
    config: &TrainConfig,
    photographs: PhotographCost,
    cost: StepCost,
    left: f64,
    finish_steps: f64,
) -> TrainConfig {
    let on_curve = f64::from(config.iterations);
    let with = |iterations| TrainConfig { iterations, ..config.clone() };
    let fits = |iterations| seconds(&with(iterations), photographs, cost, finish_steps) <= left;
    let (mut low, mut high) = (FEWEST, ((MOST_STEPS * on_curve) as u32).max(FEWEST + 1));
    while high - low > 1 + low / 200 {
        let middle = low + (high - low) / 2;
        if fits(middle) { low = middle } else { high = middle }
    }
    with(low)
}

/// The settings of the highest position of the curve whose steps fit `left` seconds, on photographs of these sizes; those of the lowest
/// position if none fits. [`with_steps_for`] then fills the time. `is_possible` excludes positions, for example those that need too
/// much memory. Settings of the caller keep their value.
///
/// # Errors
/// Names the setting of the caller that is not valid.
pub fn settings_for(
    overrides: &TrainOverrides,
    sizes: &[(u32, u32)],
    cost: StepCost,
    left: f64,
    finish_steps: f64,
    is_possible: impl Fn(&TrainConfig) -> bool,
) -> Result<TrainConfig, ConfigError> {
    let strides = ((CURVE.end() - CURVE.start()) / STRIDE).round() as u32;
    for stride in (1..=strides).rev() {
        let config = TrainConfig::at(CURVE.start() + stride as f32 * STRIDE, overrides)?;
        let photographs = reduced(sizes, config.resolution);
        if seconds(&config, photographs, cost, finish_steps) <= left && is_possible(&config) {
            return Ok(config);
        }
    }
    TrainConfig::at(*CURVE.start(), overrides)
}

/// E.g. `planned: 1,840 steps at 240 px, up to 11,000 Gaussians, ends in about 1 min 50 s`. Without `seconds` the end is
/// left out.
pub fn announcement(config: &TrainConfig, total: u32, seconds: Option<f64>) -> String {
    let (steps, most) = (grouped(total), grouped(config.max_gaussians));
    let mut text = format!("planned: {steps} steps at {} px, up to {most} Gaussians", config.resolution);
    if let Some(seconds) = seconds.filter(|seconds| seconds.is_finite()) {
        text += &format!(", ends in about {}", in_words(seconds));
    }
    text
}

/// A number with a comma between thousands.
fn grouped(number: u32) -> String {
    let digits = number.to_string();
    let mut out = String::new();
    for (k, digit) in digits.chars().enumerate() {
        if k > 0 && (digits.len() - k).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}

/// E.g. `50 s`, `1 min 50 s`, `2 h 5 min`.
fn in_words(seconds: f64) -> String {
    let whole = seconds.max(0.0).round() as u64;
    match (whole / 3_600, whole / 60 % 60, whole % 60) {
        (0, 0, s) => format!("{s} s"),
        (0, m, s) => format!("{m} min {s} s"),
        (h, m, _) => format!("{h} h {m} min"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time_budget::simulated::{CPU, GPU, PHONE};

    fn planned(overrides: &TrainOverrides, sizes: &[(u32, u32)], cost: StepCost, left: f64) -> TrainConfig {
        filled(&settings_for(overrides, sizes, cost, left, 40.0, |_| true).unwrap(), sizes, cost, left)
    }

    fn filled(config: &TrainConfig, sizes: &[(u32, u32)], cost: StepCost, left: f64) -> TrainConfig {
        with_steps_for(config, reduced(sizes, config.resolution), cost, left, 40.0)
    }

    #[test]
    fn more_time_or_a_faster_machine_gives_a_higher_position() {
        let of = |cost, left| planned(&TrainOverrides::default(), &PHONE, cost, left);
        let plans = [of(CPU, 30.0), of(CPU, 120.0), of(CPU, 1_200.0), of(GPU, 1_200.0)];
        for pair in plans.windows(2) {
            let [less, more] = pair else { unreachable!() };
            assert!(more.resolution > less.resolution, "{} {}", less.resolution, more.resolution);
            assert!(more.max_gaussians > less.max_gaussians);
        }
        assert_eq!(plans[3].resolution, 1_600, "the end of the curve");
    }

    #[test]
    fn a_plan_fills_its_time() {
        for (cost, left) in [(CPU, 120.0), (CPU, 1_200.0), (GPU, 120.0)] {
            let config = planned(&TrainOverrides::default(), &PHONE, cost, left);
            let predicted = seconds(&config, reduced(&PHONE, config.resolution), cost, 40.0);
            assert!((0.95..=1.0).contains(&(predicted / left)), "{predicted} of {left}");
        }
    }

    #[test]
    fn a_plan_has_at_most_twenty_times_the_steps_of_its_position() {
        let on_curve = TrainConfig::on_curve(3.0).iterations;
        let days = planned(&TrainOverrides::default(), &PHONE, GPU, 7.0 * 86_400.0);
        assert!(days.iterations > 19 * on_curve && days.iterations <= 20 * on_curve, "{}", days.iterations);
    }

    #[test]
    fn settings_of_the_caller_keep_their_value() {
        let overrides =
            TrainOverrides { resolution: Some(96), max_gaussians: Some(5_000), ..Default::default() };
        let config = planned(&overrides, &PHONE, CPU, 120.0);
        assert_eq!((config.resolution, config.max_gaussians), (96, 5_000));
        let wrong = TrainOverrides { resolution: Some(1), ..Default::default() };
        let error = settings_for(&wrong, &PHONE, CPU, 120.0, 40.0, |_| true).unwrap_err();
        assert_eq!(error.field, "resolution");
    }

    #[test]
    fn impossible_positions_are_passed_over() {
        let small = |config: &TrainConfig| config.max_gaussians <= 3_000;
        let config = settings_for(&TrainOverrides::default(), &PHONE, GPU, 600.0, 40.0, small).unwrap();
        assert!(config.max_gaussians <= 3_000 && config.max_gaussians > 2_500, "{}", config.max_gaussians);
        let none = planned(&TrainOverrides::default(), &PHONE, CPU, -5.0);
        assert_eq!((none.resolution, none.iterations), (64, FEWEST), "no time is left");
    }

    #[test]
    fn photographs_are_counted_at_the_reduced_size() {
        assert_eq!(reduced(&[(100, 50), (50, 100)], 200), PhotographCost { count: 2.0, pixels: 5_000.0 });
        assert_eq!(reduced(&[(400, 200)], 100).pixels, 5_000.0);
        assert_eq!(reduced(&[], 100), PhotographCost { count: 0.0, pixels: 0.0 });
    }

    #[test]
    fn a_plan_is_announced_in_words() {
        let config = TrainConfig { resolution: 240, max_gaussians: 11_000, ..TrainConfig::on_curve(0.0) };
        assert_eq!(
            announcement(&config, 1_840, Some(110.2)),
            "planned: 1,840 steps at 240 px, up to 11,000 Gaussians, ends in about 1 min 50 s"
        );
        assert!(
            announcement(&config, 840, Some(7_500.0))
                .ends_with("840 steps at 240 px, up to 11,000 Gaussians, ends in about 2 h 5 min")
        );
        assert!(!announcement(&config, 1_000_000, Some(f64::NAN)).contains("ends"));
    }
}
