//! Everything that decides how a training runs. The presets live here and nowhere else.

mod choices;
mod crop;
pub(in crate::train) mod error;
mod method;
mod white_balance;

use std::collections::BTreeMap;
use std::fmt::Display;
use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

pub use choices::{Complexity, ComplexitySetting, LabelSource, Preset};
pub use crop::{Crop, NamedCrop};
pub use error::ConfigError;
pub use method::Method;
pub use white_balance::{NamedBalance, WhiteBalance};

use crate::capture::GreyCard;
use crate::scene::ShadingOptions;
use crate::train::{KnownLight, LearningRates, LossWeights};

/// Share of the steps that train materials in which an estimated colour of the light is held: until the second restart of
/// albedo.
const ESTIMATE_SHARE: f32 = 0.3;

/// Factor on the radiance branch's weight in captures without masks: otherwise the physically based branch distorts the
/// shapes of their surroundings.
const UNMASKED_RADIANCE: f32 = 4.0;

/// Declares each setting once, a row a setting: documentation, the value for a field that an older file lacks (`serde`),
/// name, type, value in [`Preset::Standard`], `in` the range that is accepted, and what an override `decides` in place of
/// [`Complexity::Auto`]. [`TrainConfig`], [`TrainOverrides`], how one is applied to the other, and the checks follow.
macro_rules! settings {
    ($(
        $(#[doc = $doc:tt])+
        $(#[serde($($absent:tt)+)])?
        $name:ident: $type:ident = $standard:expr
        $(, in $range:expr)?
        $(, decides $($decided:ident)&+)?;
    )+) => {
        /// A complete, resolved configuration; its JSON is part of the model card and of every checkpoint.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct TrainConfig {
            /// The preset it started from.
            pub preset: Preset,
            $($(#[doc = $doc])+ $(#[serde($($absent)+)])? pub $name: $type,)+
            /// What a caller's overrides decided, in order; [`Complexity::Auto`] leaves it alone.
            #[serde(default)]
            pub forced: Vec<ComplexitySetting>,
            /// The light of the photographs, where it is known; recovered otherwise.
            #[serde(default)]
            pub light: Option<KnownLight>,
            /// Turns of the light that a caller gives, degrees by photograph; the capture's own where it gives none.
            #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
            pub light_rotation_per_photo: BTreeMap<String, f64>,
            /// Where a photograph shows a grey card; its colour becomes `white_balance` when a training starts.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub grey_card: Option<GreyCard>,
        }

        /// What a caller may change on top of a preset. Absent means the preset's value.
        #[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
        #[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
        #[serde(default, deny_unknown_fields)]
        pub struct TrainOverrides {
            $($(#[doc = $doc])+ pub $name: Option<$type>,)+
            /// The light of the photographs, where it is known: held as it is, whatever the weights and step sizes say.
            pub light: Option<KnownLight>,
            /// Turn of the light in single photographs, degrees counter-clockwise about the capture's +Z, by file name: for
            /// things on a turntable, in captures that cannot state it themselves. A name is a photograph's path in the
            /// capture or the end of it; one that fits no photograph, or several, is an error.
            pub light_rotation_per_photo: Option<BTreeMap<String, f64>>,
            /// Where a photograph shows a white or grey thing that all of the light falls on: its mean linear colour is the
            /// `white_balance`, which must not be given beside it. A channel that is clipped (mean above 0.98) or too dark (below
            /// 0.01) is an error.
            pub grey_card: Option<GreyCard>,
        }

        impl TrainOverrides {
            /// What these overrides decide in place of [`Complexity::Auto`], in order.
            fn forced(&self) -> Vec<ComplexitySetting> {
                let mut forced = Vec::new();
                $($(if self.$name.is_some() {
                    forced.extend([$(ComplexitySetting::$decided),+]);
                })?)+
                forced.sort_unstable();
                forced.dedup();
                forced
            }
        }

        impl TrainConfig {
            fn standard() -> Self {
                let (preset, forced, light) = (Preset::Standard, Vec::new(), None);
                let (light_rotation_per_photo, grey_card) = (BTreeMap::new(), None);
                Self { preset, $($name: $standard,)+ forced, light, light_rotation_per_photo, grey_card }
            }

            /// Takes the settings that `overrides` has, other than the light.
            fn apply(&mut self, overrides: &TrainOverrides) {
                $(if let Some(value) = overrides.$name {
                    self.$name = value;
                })+
            }

            fn check_ranges(&self) -> Result<(), ConfigError> {
                $($(check_range(stringify!($name), self.$name, $range)?;)?)+
                Ok(())
            }
        }

        /// Each setting's name, documentation and, if it has one, accepted range.
        #[cfg(test)]
        fn documented() -> Vec<(&'static str, &'static str, Vec<String>)> {
            vec![$((stringify!($name), concat!($($doc),+), vec![$(range_text(&$range))?])),+]
        }
    };
}

settings! {
    /// Optimisation steps, 1 to 1,000,000.
    iterations: u32 = 3_000, in 1..=1_000_000;
    /// Longest image side in pixels, 16 to 8192; photographs are never enlarged.
    resolution: u32 = 400, in 16..=8192;
    /// Gaussians at the start, 16 to 4,000,000.
    initial_gaussians: u32 = 12_000, in 16..=4_000_000;
    /// Most Gaussians the model may have, 16 to 4,000,000.
    max_gaussians: u32 = 40_000, in 16..=4_000_000, decides Gaussians;
    /// Albedo prototypes, 1 to 256.
    prototypes: u32 = 16, in 1..=256, decides Prototypes;
    /// Degree of the visibility field, 0 to 6.
    visibility_order: u32 = 4, in 0..=6, decides Visibility;
    /// Degree of the radiance branch, 0 to 3.
    radiance_order: u32 = 2, in 0..=3, decides Radiance;
    /// Rows of the environment, 4 to 64; it has twice as many columns.
    environment_rows: u32 = 16, in 4..=64;
    /// Share of the steps that only fit radiance and geometry, 0 to 1.
    warm_up: f32 = 0.25, in 0.0..=1.0;
    /// Share of the steps after which no Gaussian is added, 0 to 1.
    densify_until: f32 = 0.6, in 0.0..=1.0;
    /// Share of the steps taken at half resolution, 0 to 1.
    half_resolution: f32 = 0.15, in 0.0..=1.0;
    /// Source of the visibility labels.
    labels: LabelSource = LabelSource::Probes;
    /// Probe directions, 8 to 1024.
    probe_directions: u32 = 96, in 8..=1024;
    /// Steps between probe refreshes, 1 to 1,000,000.
    probe_every: u32 = 250, in 1..=1_000_000;
    /// Rounds of gathered light, 0 to 8.
    bounces: u32 = 2, in 0..=8, decides Indirect;
    /// The forward model. It is set as a whole: a field that is absent takes its default.
    shading: ShadingOptions = ShadingOptions::default(), decides Visibility & Indirect;
    /// Weights of the objective. They are set as a whole: one that is absent takes its default.
    weights: LossWeights = LossWeights::default();
    /// Step sizes. They are set as a whole: one that is absent takes its default.
    rates: LearningRates = LearningRates::default();
    /// Seed of every random choice.
    seed: u64 = 0;
    /// Steps between checkpoints, 1 to 1,000,000.
    checkpoint_every: u32 = 500, in 1..=1_000_000;
    /// Restarts of albedo, metalness and roughness, 0 to 5: the i-th after (2 i - 1) tenths of the steps that train materials.
    #[serde(default)]
    albedo_rounds: u32 = 3, in 0..=5;
    /// Most strong small lights that are taken out of a recovered light for their sharp shadows, 0 to 4.
    #[serde(default)]
    lights: u32 = 1, in 0..=4;
    /// Whether metalness is learned; false holds every surface at dielectric.
    #[serde(default = "learned")]
    metalness: bool = true, decides Metalness;
    /// Whether sheen is learned; false leaves every surface without.
    #[serde(default = "learned")]
    sheen: bool = true, decides Sheen;
    /// Whether the turns of the light that the capture states are used; false trains as if it had stood still.
    #[serde(default = "used")]
    light_rotations: bool = true;
    /// Whether photographs that differ in exposure or white balance are brought to one, as those of phones; captures whose light
    /// turns are left as they are.
    #[serde(default)]
    match_exposures: bool = true;
    /// Colour of the photographs' light: `auto`, `neutral`, `daylight`, a number of kelvin or `[red, green, blue]`.
    #[serde(default = "unknown")]
    white_balance: WhiteBalance = WhiteBalance::AUTO;
    /// Which part of photographs without masks becomes the model: `none` (everything), `auto` (what stands on the ground, if there is
    /// one, in the ball around which the cameras stand) or a ball `[x, y, z, radius]` in units and axes of the capture after import
    /// (+Z up). What lies outside only lights it.
    #[serde(default = "everything", skip_serializing_if = "is_everything")]
    crop: Crop = Crop::NONE;
    /// Whose model it is: `3dgs`, `gaussian-shader`, `gs-ir`, `r3dg`, `article` or `relume`. It sets other settings, under those
    /// that the caller gives.
    #[serde(default, skip_serializing_if = "Method::is_relume")]
    method: Method = Method::Relume;
    /// `auto`: leave out what the scene is measured not to require, except what the caller sets; `full`: everything.
    #[serde(default)]
    complexity: Complexity = Complexity::Full;
}

/// Turns of the light in files that do not say.
fn used() -> bool {
    true
}

/// Metalness and sheen of files that do not say.
fn learned() -> bool {
    true
}

/// White balance of files that do not say.
fn unknown() -> WhiteBalance {
    WhiteBalance::AUTO
}

/// Crop of files that do not say.
fn everything() -> Crop {
    Crop::NONE
}

fn is_everything(crop: &Crop) -> bool {
    *crop == Crop::NONE
}

fn check_range<T: PartialOrd + Display>(
    field: &str,
    value: T,
    range: RangeInclusive<T>,
) -> Result<(), ConfigError> {
    if range.contains(&value) {
        return Ok(());
    }
    Err(ConfigError::new(field, format!("{value} is outside {}", range_text(&range))))
}

fn range_text(range: &RangeInclusive<impl Display>) -> String {
    format!("{} to {}", range.start(), range.end())
}

/// Checks that every number of `group` lies in 0 to 1000.
fn check_group(name: &str, group: &impl Serialize) -> Result<(), ConfigError> {
    let fields = serde_json::to_value(group).unwrap_or_default();
    for (field, value) in fields.as_object().into_iter().flatten() {
        // A non-finite float serialises as null.
        if !value.as_f64().is_some_and(|v| (0.0..=1e3).contains(&v)) {
            return Err(ConfigError::new(format!("{name}.{field}"), "must lie in 0 to 1000"));
        }
    }
    Ok(())
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
        let standard = Self::standard();
        match preset {
            Preset::Standard => standard,
            Preset::Draft => Self {
                preset,
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
                preset,
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
    pub fn new(preset: Preset, overrides: &TrainOverrides) -> Result<Self, ConfigError> {
        let mut config = Self::preset(preset);
        let method: TrainOverrides = serde_json::from_value(overrides.method.unwrap_or_default().overrides())
            .map_err(|error| ConfigError::new("method", error.to_string()))?;
        config.apply(&method);
        config.apply(overrides);
        config.forced = method.forced();
        config.forced.extend(overrides.forced());
        config.forced.sort_unstable();
        config.forced.dedup();
        config.light_rotation_per_photo = overrides.light_rotation_per_photo.clone().unwrap_or_default();
        config.grey_card = overrides.grey_card.clone();
        if config.grey_card.is_some() && overrides.white_balance.is_some() {
            return Err(ConfigError::new("grey_card", "cannot be given beside white_balance"));
        }
        if let Some(light) = &overrides.light {
            config.hold_light(light);
        }
        config.check()?;
        config.initial_gaussians = config.initial_gaussians.min(config.max_gaussians);
        Ok(config)
    }

    /// Holds the light at a known one: no step changes it, and no term of the objective acts on it.
    fn hold_light(&mut self, light: &KnownLight) {
        self.light = Some(light.clone());
        self.rates.environment = 0.0;
        (self.weights.light, self.weights.exposure, self.weights.light_colour) = (0.0, 0.0, 0.0);
    }

    fn check(&self) -> Result<(), ConfigError> {
        if let Some(light) = &self.light {
            light.check()?;
        }
        self.white_balance.check()?;
        self.crop.check(self.warm_up)?;
        if let Some(card) = &self.grey_card {
            for (side, pixels) in [("width", card.width), ("height", card.height)] {
                check_range(&format!("grey_card.{side}"), pixels, 1..=u32::MAX)?;
            }
        }
        if let Some((name, _)) = self.light_rotation_per_photo.iter().find(|(_, turn)| !turn.is_finite()) {
            return Err(ConfigError::new(format!("light_rotation_per_photo.{name}"), "must be finite"));
        }
        self.check_ranges()?;
        check_group("weights", &self.weights)?;
        check_group("rates", &self.rates)
    }

    /// Weight of the term on the light's colour after `progress`, a share of all steps: to the end where the colour is known,
    /// else 0 once three tenths of the steps that train materials are done.
    pub fn light_colour_weight(&self, progress: f32) -> f32 {
        let until = self.warm_up + ESTIMATE_SHARE * (1.0 - self.warm_up);
        let holds = self.white_balance.known().is_some() || progress < until;
        if holds { self.weights.light_colour } else { 0.0 }
    }

    /// Where the colour of the light that materials start from comes from: `light`, `white_balance` or `view_dependence`.
    pub fn colour_source(&self) -> &'static str {
        match (&self.light, self.white_balance.known()) {
            (Some(_), _) => "light",
            (None, Some(_)) => "white_balance",
            (None, None) => "view_dependence",
        }
    }

    /// True when the exposures of photographs are compared before this step: four times from a fifth to half of the steps that
    /// train materials.
    pub fn is_exposure_round(&self, step: u32) -> bool {
        let (first, material) = (self.warm_up_steps(), self.iterations - self.warm_up_steps());
        let after = |tenths: u32| u64::from(material) * u64::from(tenths) / 20;
        self.match_exposures
            && step > first
            && [4, 6, 8, 10].iter().any(|t| after(*t) == u64::from(step - first))
    }

    /// Weight of the radiance branch beside the physically based one.
    pub fn radiance_weight(&self, has_alpha: bool) -> f32 {
        if has_alpha { self.weights.radiance } else { UNMASKED_RADIANCE * self.weights.radiance }
    }

    /// Steps of the radiance warm-up.
    pub fn warm_up_steps(&self) -> u32 {
        (self.warm_up * self.iterations as f32) as u32
    }

    /// True when albedo restarts before this step.
    pub fn is_albedo_round(&self, step: u32) -> bool {
        let first = self.warm_up_steps();
        let after = |round: u32| u64::from(self.iterations - first) * u64::from(2 * round + 1) / 10;
        step > first && (0..self.albedo_rounds).any(|round| after(round) == u64::from(step - first))
    }
}

#[cfg(test)]
mod tests;
