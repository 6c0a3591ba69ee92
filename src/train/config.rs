//! Everything that decides how a training runs. The presets live here and nowhere else.

use serde::{Deserialize, Serialize};

use crate::scene::ShadingOptions;
use crate::train::{KnownLight, LearningRates, LossWeights};

/// A named trade of time against quality.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema, sqlx::Type), sqlx(rename_all = "snake_case"))]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// A look at the result within a few minutes.
    Draft,
    /// The default.
    #[default]
    Standard,
    /// Everything, at length.
    High,
}

/// Where visibility is learned from (article Eq. 14-15, DESIGN 4.1).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum LabelSource {
    /// No labels: only the photometric gradient.
    None,
    /// Backward transmittance along camera rays (the article).
    Backward,
    /// Transmittance probes over the sphere.
    #[default]
    Probes,
    /// Both.
    Both,
}

/// How much of the model a scene gets (DESIGN 7).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Complexity {
    /// What the scene is measured to require; evidence and decisions go into the model card.
    Auto,
    /// Everything that is configured.
    #[default]
    Full,
}

/// What [`Complexity::Auto`] decides on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Setting {
    /// Degree of the visibility field, or none at all.
    Visibility,
    /// Light that bounces.
    Indirect,
    /// Degree of the radiance branch.
    Radiance,
    /// Metalness, learned or held at dielectric.
    Metalness,
    /// Number of albedo prototypes.
    Prototypes,
    /// Sheen.
    Sheen,
    /// Number of Gaussians.
    Gaussians,
}

/// Share of the steps that train materials in which the light's colour is held at daylight: to the second round of albedo.
const DAYLIT: f32 = 0.3;

/// How much more the radiance branch weighs in captures without masks, whose shapes the physically based one bends
/// (docs/experiments.md, "Where surfaces are shaded").
const SURROUNDINGS: f32 = 4.0;

/// A complete, resolved configuration; its JSON is part of the model card and of every checkpoint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainConfig {
    /// The preset it started from.
    pub preset: Preset,
    /// Optimisation steps.
    pub iterations: u32,
    /// Longest image side, pixels; photographs are never enlarged.
    pub resolution: u32,
    /// Gaussians at the start.
    pub initial_gaussians: u32,
    /// Most Gaussians.
    pub max_gaussians: u32,
    /// Albedo prototypes K, 1 to 256.
    pub prototypes: u32,
    /// Degree of the visibility field, 0 to 6.
    pub visibility_order: u32,
    /// Degree of the radiance branch, 0 to 3.
    pub radiance_order: u32,
    /// Rows of the environment; it has twice as many columns.
    pub environment_rows: u32,
    /// Share of the steps that only fit radiance and geometry.
    pub warm_up: f32,
    /// Share of the steps after which no Gaussian is added.
    pub densify_until: f32,
    /// Share of the steps taken at half resolution.
    pub half_resolution: f32,
    /// Source of the visibility labels.
    pub labels: LabelSource,
    /// Probe directions.
    pub probe_directions: u32,
    /// Steps between probe refreshes.
    pub probe_every: u32,
    /// Rounds of gathered light, 0 to 8.
    pub bounces: u32,
    /// The forward model.
    pub shading: ShadingOptions,
    /// Weights of the objective.
    pub weights: LossWeights,
    /// Step sizes.
    pub rates: LearningRates,
    /// Seed of every random choice.
    pub seed: u64,
    /// Steps between checkpoints.
    pub checkpoint_every: u32,
    /// How often albedo starts anew from colours with the light divided out, and metalness and roughness from their first
    /// values, 0 to 5: round i after (2 i + 1) tenths of the steps that train materials.
    #[serde(default)]
    pub albedo_rounds: u32,
    /// Whether metalness is learned; false holds every surface at dielectric.
    #[serde(default = "learned")]
    pub metalness: bool,
    /// Whether sheen is learned; false leaves every surface without.
    #[serde(default = "learned")]
    pub sheen: bool,
    /// Everything that is configured, or what the scene requires of it.
    #[serde(default)]
    pub complexity: Complexity,
    /// What a caller named; [`Complexity::Auto`] leaves it alone.
    #[serde(default)]
    pub forced: Vec<Setting>,
    /// The light of the photographs, where it is known; recovered otherwise.
    #[serde(default)]
    pub light: Option<KnownLight>,
}

fn learned() -> bool {
    true
}

/// What a caller may change on top of a preset. Absent means the preset's value.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct TrainOverrides {
    /// Optimisation steps, 1 to 1,000,000.
    pub iterations: Option<u32>,
    /// Longest image side in pixels, 16 to 8192.
    pub resolution: Option<u32>,
    /// Gaussians at the start, 16 to 4,000,000.
    pub initial_gaussians: Option<u32>,
    /// Most Gaussians the model may have, 16 to 4,000,000.
    pub max_gaussians: Option<u32>,
    /// Albedo prototypes, 1 to 256.
    pub prototypes: Option<u32>,
    /// Degree of the visibility field, 0 to 6.
    pub visibility_order: Option<u32>,
    /// Degree of the radiance branch, 0 to 3.
    pub radiance_order: Option<u32>,
    /// Rows of the environment, 4 to 64.
    pub environment_rows: Option<u32>,
    /// Share of radiance-only steps, 0 to 1.
    pub warm_up: Option<f32>,
    /// Share of the steps after which no Gaussian is added, 0 to 1.
    pub densify_until: Option<f32>,
    /// Share of the steps taken at half resolution, 0 to 1.
    pub half_resolution: Option<f32>,
    /// Source of the visibility labels.
    pub labels: Option<LabelSource>,
    /// Probe directions, 8 to 1024.
    pub probe_directions: Option<u32>,
    /// Steps between probe refreshes, at least 1.
    pub probe_every: Option<u32>,
    /// Rounds of gathered light, 0 to 8.
    pub bounces: Option<u32>,
    /// The forward model, whole.
    pub shading: Option<ShadingOptions>,
    /// Weights of the objective, whole; absent ones take their default.
    pub weights: Option<LossWeights>,
    /// Step sizes, whole; absent ones take their default.
    pub rates: Option<LearningRates>,
    /// Seed of every random choice.
    pub seed: Option<u64>,
    /// Steps between checkpoints, at least 1.
    pub checkpoint_every: Option<u32>,
    /// How often albedo, metalness and roughness start anew, 0 to 5.
    pub albedo_rounds: Option<u32>,
    /// Whether metalness is learned; false holds every surface at dielectric.
    pub metalness: Option<bool>,
    /// Whether sheen is learned; false leaves every surface without.
    pub sheen: Option<bool>,
    /// `auto`: leave out what the scene is measured not to require, except what is named here; `full`: everything.
    pub complexity: Option<Complexity>,
    /// The light of the photographs, where it is known: held as it is, whatever the weights and step sizes say.
    pub light: Option<KnownLight>,
}

impl TrainOverrides {
    /// The decisions that these overrides take out of the hands of [`Complexity::Auto`].
    fn forced(&self) -> Vec<Setting> {
        let named = [
            (Setting::Visibility, self.visibility_order.is_some() || self.shading.is_some()),
            (Setting::Indirect, self.bounces.is_some() || self.shading.is_some()),
            (Setting::Radiance, self.radiance_order.is_some()),
            (Setting::Metalness, self.metalness.is_some()),
            (Setting::Sheen, self.sheen.is_some()),
            (Setting::Prototypes, self.prototypes.is_some()),
            (Setting::Gaussians, self.max_gaussians.is_some()),
        ];
        named.into_iter().filter_map(|(setting, is_named)| is_named.then_some(setting)).collect()
    }
}

impl TrainConfig {
    /// The preset itself.
    ///
    /// | preset | steps | px | Gaussians | probes | prototypes |
    /// |---|---|---|---|---|---|
    /// | draft | 1,500 | 160 | 8,000 | 64 | 8 |
    /// | standard | 3,000 | 400 | 40,000 | 96 | 16 |
    /// | high | 6,000 | 800 | 80,000 | 128 | 16 |
    pub fn preset(preset: Preset) -> Self {
        let standard = Self {
            preset,
            iterations: 3_000,
            resolution: 400,
            initial_gaussians: 12_000,
            max_gaussians: 40_000,
            prototypes: 16,
            visibility_order: 4,
            radiance_order: 2,
            environment_rows: 16,
            warm_up: 0.25,
            densify_until: 0.6,
            half_resolution: 0.15,
            labels: LabelSource::Probes,
            probe_directions: 96,
            probe_every: 250,
            bounces: 2,
            shading: ShadingOptions::default(),
            weights: LossWeights::default(),
            rates: LearningRates::default(),
            seed: 0,
            checkpoint_every: 500,
            albedo_rounds: 3,
            metalness: true,
            sheen: true,
            complexity: Complexity::default(),
            forced: Vec::new(),
            light: None,
        };
        match preset {
            Preset::Standard => standard,
            Preset::Draft => Self {
                iterations: 1_500,
                resolution: 160,
                initial_gaussians: 3_000,
                max_gaussians: 8_000,
                prototypes: 8,
                radiance_order: 1,
                probe_directions: 64,
                probe_every: 125,
                checkpoint_every: 250,
                ..standard
            },
            Preset::High => Self {
                iterations: 6_000,
                resolution: 800,
                initial_gaussians: 24_000,
                max_gaussians: 80_000,
                probe_directions: 128,
                ..standard
            },
        }
    }

    /// A preset with a caller's changes.
    ///
    /// # Errors
    /// Names the field that is out of range.
    pub fn new(preset: Preset, overrides: &TrainOverrides) -> Result<Self, String> {
        let mut config = Self::preset(preset);
        macro_rules! apply {
            ($($field:ident),*) => { $(if let Some(v) = overrides.$field { config.$field = v; })* };
        }
        apply!(
            iterations,
            resolution,
            initial_gaussians,
            max_gaussians,
            prototypes,
            visibility_order,
            radiance_order,
            environment_rows,
            warm_up,
            densify_until,
            half_resolution,
            labels,
            probe_directions,
            probe_every,
            bounces,
            shading,
            weights,
            rates,
            seed,
            checkpoint_every,
            albedo_rounds,
            metalness,
            sheen,
            complexity
        );
        config.forced = overrides.forced();
        if let Some(light) = &overrides.light {
            config.hold(light);
        }
        config.initial_gaussians = config.initial_gaussians.min(config.max_gaussians);
        config.checked()
    }

    /// Takes the light as it is: no step moves it, and no term has an opinion on it.
    fn hold(&mut self, light: &KnownLight) {
        self.light = Some(light.clone());
        self.rates.environment = 0.0;
        (self.weights.light, self.weights.exposure, self.weights.daylight) = (0.0, 0.0, 0.0);
    }

    fn checked(self) -> Result<Self, String> {
        if let Some(light) = &self.light {
            light.check()?;
        }
        let whole = [
            ("iterations", self.iterations, 1, 1_000_000),
            ("resolution", self.resolution, 16, 8192),
            ("initial_gaussians", self.initial_gaussians, 16, 4_000_000),
            ("max_gaussians", self.max_gaussians, 16, 4_000_000),
            ("prototypes", self.prototypes, 1, 256),
            ("visibility_order", self.visibility_order, 0, 6),
            ("radiance_order", self.radiance_order, 0, 3),
            ("environment_rows", self.environment_rows, 4, 64),
            ("probe_directions", self.probe_directions, 8, 1024),
            ("probe_every", self.probe_every, 1, 1_000_000),
            ("bounces", self.bounces, 0, 8),
            ("checkpoint_every", self.checkpoint_every, 1, 1_000_000),
            ("albedo_rounds", self.albedo_rounds, 0, 5),
        ];
        for (name, value, lo, hi) in whole {
            if !(lo..=hi).contains(&value) {
                return Err(format!("{name}: {value} is outside {lo} to {hi}"));
            }
        }
        let shares = [
            ("warm_up", self.warm_up),
            ("densify_until", self.densify_until),
            ("half_resolution", self.half_resolution),
        ];
        for (name, value) in shares {
            if !(0.0..=1.0).contains(&value) {
                return Err(format!("{name}: {value} is outside 0 to 1"));
            }
        }
        let json = serde_json::json!({"weights": self.weights, "rates": self.rates});
        for (group, fields) in json.as_object().into_iter().flatten() {
            for (name, value) in fields.as_object().into_iter().flatten() {
                // A non-finite float serialises as null.
                if !value.as_f64().is_some_and(|v| (0.0..=1e3).contains(&v)) {
                    return Err(format!("{group}.{name}: must lie in 0 to 1000"));
                }
            }
        }
        Ok(self)
    }

    /// Weight of the daylight term after `progress`, a share of all steps: nothing once three tenths of those that train
    /// materials are done.
    pub fn daylight_weight(&self, progress: f32) -> f32 {
        let until = self.warm_up + DAYLIT * (1.0 - self.warm_up);
        if progress < until { self.weights.daylight } else { 0.0 }
    }

    /// Weight of the radiance branch beside the physically based one.
    pub fn radiance_weight(&self, has_alpha: bool) -> f32 {
        if has_alpha { self.weights.radiance } else { SURROUNDINGS * self.weights.radiance }
    }

    /// Steps of the radiance warm-up.
    pub fn warm_up_steps(&self) -> u32 {
        (self.warm_up * self.iterations as f32) as u32
    }

    /// True when albedo starts anew before this step.
    pub fn is_albedo_round(&self, step: u32) -> bool {
        let first = self.warm_up_steps();
        let after = |round: u32| u64::from(self.iterations - first) * u64::from(2 * round + 1) / 10;
        step > first && (0..self.albedo_rounds).any(|round| after(round) == u64::from(step - first))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overrides_change_only_what_they_name() {
        let overrides = TrainOverrides { iterations: Some(7), ..Default::default() };
        let config = TrainConfig::new(Preset::Draft, &overrides).unwrap();
        assert_eq!(TrainConfig { iterations: 1_500, ..config }, TrainConfig::preset(Preset::Draft));
    }

    #[test]
    fn what_a_caller_names_is_forced_and_nothing_else_is() {
        let forced = |o: TrainOverrides| TrainConfig::new(Preset::Draft, &o).unwrap().forced;
        assert_eq!(
            forced(TrainOverrides { visibility_order: Some(3), ..Default::default() }),
            [Setting::Visibility]
        );
        let shading =
            forced(TrainOverrides { shading: Some(ShadingOptions::default()), ..Default::default() });
        assert_eq!(shading, [Setting::Visibility, Setting::Indirect]);
        assert!(forced(TrainOverrides { iterations: Some(9), ..Default::default() }).is_empty());
    }

    #[test]
    fn what_is_out_of_range_is_named() {
        let refused = |o: TrainOverrides| TrainConfig::new(Preset::Draft, &o).unwrap_err();
        assert!(refused(TrainOverrides { iterations: Some(0), ..Default::default() }).contains("iterations"));
        assert!(
            refused(TrainOverrides { warm_up: Some(f32::NAN), ..Default::default() }).contains("warm_up")
        );
        let rates = LearningRates { mean: f32::INFINITY, ..Default::default() };
        assert!(refused(TrainOverrides { rates: Some(rates), ..Default::default() }).contains("rates.mean"));
        let unknown = serde_json::from_str::<TrainOverrides>(r#"{"iterration": 5}"#).unwrap_err();
        assert!(unknown.to_string().contains("iterration"));
    }

    #[test]
    fn daylight_holds_until_the_second_round() {
        let config = TrainConfig::preset(Preset::Draft);
        let first = config.warm_up_steps();
        let is_round = |step: &u32| config.is_albedo_round(*step);
        let second = (first..config.iterations).filter(is_round).nth(1).unwrap();
        let weight = |step: u32| config.daylight_weight(step as f32 / config.iterations as f32);
        assert_eq!(weight(first), config.weights.daylight);
        assert_eq!(weight(second - 2), config.weights.daylight);
        assert_eq!(weight(second + 2), 0.0);
    }

    #[test]
    fn surroundings_are_the_radiance_branchs() {
        let config = TrainConfig::preset(Preset::Draft);
        assert_eq!(config.radiance_weight(true), config.weights.radiance);
        assert!(config.radiance_weight(false) > config.weights.radiance);
    }

    #[test]
    fn rounds_come_at_odd_tenths_of_the_material_steps() {
        let config = TrainConfig { albedo_rounds: 3, ..TrainConfig::preset(Preset::Draft) };
        let steps: Vec<u32> = (0..config.iterations).filter(|s| config.is_albedo_round(*s)).collect();
        assert_eq!(steps, [375 + 112, 375 + 337, 375 + 562]);
        let none = TrainConfig { albedo_rounds: 0, ..config };
        assert!(!(0..none.iterations).any(|s| none.is_albedo_round(s)), "the control");
    }
}
