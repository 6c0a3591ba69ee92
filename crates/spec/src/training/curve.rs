//! The curve of settings on which the presets are named points: one position determines pixels, steps and Gaussians.

use std::ops::RangeInclusive;

use super::{Preset, TrainConfig};

/// Positions of the curve. `draft` is at 0, `standard` at 1, `high` at 2.
pub const CURVE: RangeInclusive<f32> = -1.0..=3.0;

impl Preset {
    /// Position on the curve.
    pub fn position(self) -> f32 {
        match self {
            Self::Draft => 0.0,
            Self::Standard => 1.0,
            Self::High => 2.0,
        }
    }

    /// The preset closest to a position of the curve.
    pub fn nearest(position: f32) -> Self {
        match position {
            p if p < 0.5 => Self::Draft,
            p if p < 1.5 => Self::Standard,
            _ => Self::High,
        }
    }
}

/// A setting at `position`, given its values at 0, 1 and 2: geometric between them and beyond, rounded to a multiple
/// of `unit`.
fn geometric(position: f32, values: [u32; 3], unit: u32) -> u32 {
    let values = values.map(f64::from);
    let (from, to, share) = match position < 1.0 {
        true => (values[0], values[1], f64::from(position)),
        false => (values[1], values[2], f64::from(position) - 1.0),
    };
    let value = from * (to / from).powf(share);
    ((value / f64::from(unit)).round() as u32).max(1) * unit
}

impl TrainConfig {
    /// The settings at a position of the curve; positions outside [`CURVE`] are clamped to it, NaN is `draft`.
    ///
    /// | position | preset | steps | px | Gaussians | probes | prototypes |
    /// |---|---|---|---|---|---|---|
    /// | -1 | | 750 | 64 | 1,600 | 128 | 8 |
    /// | 0 | draft | 1,500 | 160 | 8,000 | 128 | 8 |
    /// | 1 | standard | 3,000 | 400 | 40,000 | 128 | 16 |
    /// | 2 | high | 6,000 | 800 | 80,000 | 128 | 16 |
    /// | 3 | | 12,000 | 1,600 | 160,000 | 128 | 16 |
    pub fn on_curve(position: f32) -> Self {
        let at = if position.is_nan() { 0.0 } else { position.clamp(*CURVE.start(), *CURVE.end()) };
        Self {
            preset: Preset::nearest(at),
            iterations: geometric(at, [1_500, 3_000, 6_000], 10),
            resolution: geometric(at, [160, 400, 800], 8),
            initial_gaussians: geometric(at, [3_000, 12_000, 24_000], 50),
            max_gaussians: geometric(at, [8_000, 40_000, 80_000], 100),
            prototypes: geometric(at, [8, 16, 16], 1).max(8),
            radiance_order: if at < 0.5 { 1 } else { 2 },
            probe_every: geometric(at, [125, 250, 250], 1),
            checkpoint_every: geometric(at, [250, 500, 500], 1),
            ..Self::standard()
        }
    }

    /// Takes the settings that the position on the curve determines from `planned`, and its number of steps.
    pub fn adopt_plan(&mut self, planned: &Self) {
        self.preset = planned.preset;
        self.iterations = planned.iterations;
        self.resolution = planned.resolution;
        self.initial_gaussians = planned.initial_gaussians;
        self.max_gaussians = planned.max_gaussians;
        self.prototypes = planned.prototypes;
        self.radiance_order = planned.radiance_order;
        self.probe_directions = planned.probe_directions;
        self.probe_every = planned.probe_every;
        self.checkpoint_every = planned.checkpoint_every;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_points_of_the_curve() {
        let of = |preset| {
            let c = TrainConfig::preset(preset);
            let counts = [c.iterations, c.resolution, c.initial_gaussians, c.max_gaussians, c.prototypes];
            (counts, [c.radiance_order, c.probe_directions, c.probe_every, c.checkpoint_every])
        };
        assert_eq!(of(Preset::Draft), ([1_500, 160, 3_000, 8_000, 8], [1, 128, 125, 250]));
        assert_eq!(of(Preset::Standard), ([3_000, 400, 12_000, 40_000, 16], [2, 128, 250, 500]));
        assert_eq!(of(Preset::High), ([6_000, 800, 24_000, 80_000, 16], [2, 128, 250, 500]));
        for preset in [Preset::Draft, Preset::Standard, Preset::High] {
            assert_eq!(TrainConfig::preset(preset).preset, preset);
        }
    }

    #[test]
    fn settings_grow_along_the_curve_and_stay_within_it() {
        let points: Vec<TrainConfig> = (-20..=60).map(|k| TrainConfig::on_curve(k as f32 / 20.0)).collect();
        for pair in points.windows(2) {
            let [a, b] = pair else { unreachable!() };
            assert!(a.iterations <= b.iterations && a.resolution <= b.resolution);
            assert!(a.initial_gaussians <= b.initial_gaussians && a.max_gaussians < b.max_gaussians);
            assert!(a.check().is_ok() && b.check().is_ok());
        }
        assert_eq!(TrainConfig::on_curve(-9.0), TrainConfig::on_curve(-1.0));
        assert_eq!(TrainConfig::on_curve(9.0).max_gaussians, 160_000);
        assert_eq!(TrainConfig::on_curve(f32::NAN), TrainConfig::preset(Preset::Draft));
    }

    #[test]
    fn an_adopted_plan_keeps_the_other_settings() {
        let mut config = TrainConfig { seed: 7, ..TrainConfig::preset(Preset::Draft) };
        config.adopt_plan(&TrainConfig { iterations: 777, ..TrainConfig::on_curve(0.4) });
        assert_eq!((config.seed, config.iterations), (7, 777));
        assert_eq!(config, TrainConfig { seed: 7, iterations: 777, ..TrainConfig::on_curve(0.4) });
    }
}
