//! Settings and presets of trainings.

mod choices;
mod colour_chart;
mod crop;
mod curve;
mod error;
mod grey_card;
mod group;
mod known_light;
mod light_groups;
mod method;
mod range;
mod reference;
#[cfg(test)]
mod settings_page;
mod shading;
mod time_budget;
mod until;
mod weights;
mod white_balance;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

pub use choices::{Complexity, ComplexitySetting, LabelSource, Preset, TurntableCapture, UpAxis};
pub use colour_chart::{ChartEdition, ColourChart};
pub use crop::{Crop, NamedCrop};
pub use curve::CURVE;
pub use error::ConfigError;
pub use grey_card::GreyCard;
pub use known_light::{Auto, KnownLight, LightExposure, MAX_STOPS};
pub use light_groups::{LIGHT_GROUP_NAME, is_light_group_name};
pub use method::Method;
pub use reference::{Setting, settings};
pub use shading::ShadingChanges;
pub use time_budget::{TIME_BUDGET, TimeBudget};
pub use until::{Until, UntilFigure};
pub use weights::{LearningRateChanges, LearningRates, LossWeightChanges, LossWeights};
pub use white_balance::{NamedBalance, WhiteBalance};

use range::{GROUP_RANGE, check_group, check_range, range_text};
use relume_scene::ShadingOptions;

/// Share of the steps that train materials during which an estimated colour of the light is kept: until the
/// second restart of albedo.
const ESTIMATE_SHARE: f32 = 0.3;
/// Distance from the estimated colour that the light may have after these steps, in `ln(blue / red)` and `ln(green^2 / (red blue))`.
const ESTIMATE_TOLERANCE: f32 = 0.15;

/// Factor on the weight of the radiance branch in captures without masks. Without it, the physically based
/// branch distorts the shapes of the surroundings.
const UNMASKED_RADIANCE: f32 = 4.0;

/// Declares each setting once, one row per setting: documentation, value for a field that an older file lacks
/// (`serde`), name, type, value in [`Preset::Standard`], accepted range (`in`), and the settings that an
/// override `decides` in place of [`Complexity::Auto`].
///
/// The macro generates [`TrainConfig`], [`TrainOverrides`], the application of overrides to a configuration,
/// and the checks.
macro_rules! settings {
    ($(
        $(#[doc = $doc:tt])+
        $(#[serde($($absent:tt)+)])?
        $name:ident: $type:ident = $standard:expr
        $(, in $range:expr)?
        $(, decides $($decided:ident)&+)?;
    )+
    groups {$(
        $(#[doc = $group_doc:tt])+
        $group:ident: $group_type:ident changed by $changes:ident
        $(, decides $($group_decided:ident)&+)?;
    )+}) => {
        /// A complete, resolved configuration. Its JSON is part of the model card and of every checkpoint.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct TrainConfig {
            /// Preset on which the configuration is based.
            pub preset: Preset,
            $($(#[doc = $doc])+ $(#[serde($($absent)+)])? pub $name: $type,)+
            $($(#[doc = $group_doc])+ pub $group: $group_type,)+
            /// Settings that a caller's overrides decided, in order. [`Complexity::Auto`] does not change
            /// them.
            #[serde(default)]
            pub forced: Vec<ComplexitySetting>,
            /// Known light of the photographs. Without it, training recovers the light.
            #[serde(default)]
            pub light: Option<KnownLight>,
            /// Rotations of the light that a caller gives, degrees, by photograph. Without them, those of the
            /// capture apply.
            #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
            pub light_rotation_per_photo: BTreeMap<String, f64>,
            /// Light groups that a caller gives: a pattern of file names by the name of the group. Without them, those of the
            /// capture apply.
            #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
            pub light_groups: BTreeMap<String, String>,
            /// Rectangle of a photograph that shows a grey card. Its colour becomes `white_balance` at the
            /// start of a training.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub grey_card: Option<GreyCard>,
            /// Colour chart in a photograph. Its matrix is applied to all photographs, and `white_balance` is `neutral`.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub colour_chart: Option<ColourChart>,
            /// Time that the training may take, seconds. Pixels, steps and Gaussians were planned for it.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub time_budget_s: Option<u32>,
            /// Condition on held-out photographs at which the training stops before its last step.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub until: Option<Until>,
        }

        /// Settings that replace values of the preset. An omitted setting has the preset's value.
        #[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
        #[derive(utoipa::ToSchema)]
        #[serde(default, deny_unknown_fields)]
        pub struct TrainOverrides {
            $($(#[doc = $doc])+ pub $name: Option<$type>,)+
            $($(#[doc = $group_doc])+ pub $group: Option<$changes>,)+
            /// Known light of the photographs. Training keeps it fixed, regardless of weights and step sizes.
            /// Omitted: training recovers the light.
            pub light: Option<KnownLight>,
            /// Rotation of the light in single photographs by file name, degrees counter-clockwise about the
            /// capture's +Z: for objects on a turntable, in captures whose files cannot state the rotation. A
            /// name is the path of a photograph in the capture or the end of that path. A name that matches
            /// no photograph or several photographs is an error.
            pub light_rotation_per_photo: Option<BTreeMap<String, f64>>,
            /// Photographs that share a light, for captures under several lights (day and evening, without and with flash): for each
            /// name of a group, the pattern of the file names of its photographs. `*` stands for any characters, `?` for one. Photographs
            /// that match no pattern are a further group. Each group has a light of its own; materials and shape are common. A pattern
            /// that matches no photograph is an error, and so is a photograph that two patterns match.
            pub light_groups: Option<BTreeMap<String, String>>,
            /// Rectangle of a photograph that shows a white or grey surface which receives all of the light.
            /// Its mean linear colour replaces `white_balance`; the two must not be combined. A channel that
            /// is clipped (mean above 0.98) or too dark (mean below 0.01) is an error.
            pub grey_card: Option<GreyCard>,
            /// Colour chart of 24 patches in a photograph. It determines a 3 x 3 matrix that is applied to the linear colours of all
            /// photographs, including held-out ones, and the level of albedo. The photographs then show white surfaces as grey, so
            /// that `white_balance` is `neutral`; another `white_balance`, `grey_card` and `light` must not be combined with it.
            pub colour_chart: Option<ColourChart>,
            /// Time that the training may take, seconds, 30 to 604,800 (7 days). It replaces the preset:
            /// `resolution`, `iterations`, `max_gaussians` and the settings that depend on them are planned from
            /// the speed of the machine. `resolution` and `max_gaussians` may be given as well; `iterations` must
            /// not.
            #[serde(skip_serializing_if = "Option::is_none")]
            #[schema(minimum = 30, maximum = 604_800)]
            pub time_budget_s: Option<u32>,
            /// Condition at which the training stops before its last step: `novel_view.psnr>=30` or
            /// `novel_view.ssim>=0.95`, measured on held-out photographs at the training resolution. It also stops
            /// if nothing more is gained. The last tenth of the schedule is always completed.
            #[serde(skip_serializing_if = "Option::is_none")]
            #[schema(value_type = Option<String>)]
            pub until: Option<Until>,
        }

        impl TrainOverrides {
            /// Settings that these overrides decide in place of [`Complexity::Auto`], in order.
            fn forced(&self) -> Vec<ComplexitySetting> {
                let mut forced = Vec::new();
                $($(if self.$name.is_some() {
                    forced.extend([$(ComplexitySetting::$decided),+]);
                })?)+
                $($(if self.$group.is_some() {
                    forced.extend([$(ComplexitySetting::$group_decided),+]);
                })?)+
                forced.sort_unstable();
                forced.dedup();
                forced
            }
        }

        impl TrainConfig {
            fn standard() -> Self {
                let (preset, forced, light) = (Preset::Standard, Vec::new(), None);
                let (light_rotation_per_photo, light_groups) = (BTreeMap::new(), BTreeMap::new());
                let (grey_card, colour_chart, time_budget_s, until) = (None, None, None, None);
                Self { preset, $($name: $standard,)+ $($group: Default::default(),)+ forced, light, light_rotation_per_photo, light_groups, grey_card, colour_chart, time_budget_s, until }
            }

            /// Applies the settings of `overrides`, except the light.
            fn apply(&mut self, overrides: &TrainOverrides) {
                $(if let Some(value) = overrides.$name {
                    self.$name = value;
                })+
                $(if let Some(changes) = &overrides.$group {
                    changes.apply(&mut self.$group);
                })+
            }

            /// The value of a setting that is no group, as JSON.
            #[cfg(test)]
            fn value_of(&self, name: &str) -> Option<serde_json::Value> {
                match name {
                    $(stringify!($name) => serde_json::to_value(&self.$name).ok(),)+
                    _ => None,
                }
            }

            fn check_ranges(&self) -> Result<(), ConfigError> {
                $($(check_range(stringify!($name), self.$name, $range)?;)?)+
                Ok(())
            }
        }

        /// Name, type, documentation and accepted range, if any, of each setting that is no group.
        fn declared() -> Vec<(&'static str, &'static str, &'static str, Option<String>)> {
            vec![$(
                (stringify!($name), stringify!($type), concat!($($doc),+), [$(range_text(&$range))?].into_iter().next()),
            )+]
        }
    };
}

settings! {
    /// Optimisation steps, 1 to 1,000,000.
    iterations: u32 = 3_000, in 1..=1_000_000;
    /// Longest image side in pixels, 16 to 8192. Photographs are never enlarged.
    resolution: u32 = 400, in 16..=8192;
    /// Initial number of Gaussians, 16 to 4,000,000.
    initial_gaussians: u32 = 12_000, in 16..=4_000_000;
    /// Maximum number of Gaussians, 16 to 4,000,000.
    max_gaussians: u32 = 40_000, in 16..=4_000_000, decides Gaussians;
    /// Number of albedo prototypes, 1 to 256.
    prototypes: u32 = 16, in 1..=256, decides Prototypes;
    /// SH degree of the visibility field, 0 to 6.
    visibility_order: u32 = 4, in 0..=6, decides Visibility;
    /// SH degree of the radiance branch, 0 to 3.
    radiance_order: u32 = 2, in 0..=3, decides Radiance;
    /// Rows of the environment map, 4 to 64. It has twice as many columns.
    environment_rows: u32 = 16, in 4..=64;
    /// Share of the steps that fit only radiance and geometry, 0 to 1.
    warm_up: f32 = 0.25, in 0.0..=1.0;
    /// Share of the steps after which no Gaussians are added, 0 to 1.
    densify_until: f32 = 0.6, in 0.0..=1.0;
    /// Share of the steps at half resolution, 0 to 1.
    half_resolution: f32 = 0.15, in 0.0..=1.0;
    /// Source of the visibility labels: `none`, `backward` (transmittance along camera rays), `probes`
    /// (transmittance over the sphere) or `both`.
    labels: LabelSource = LabelSource::Probes;
    /// Number of probe directions, 8 to 1024.
    probe_directions: u32 = 128, in 8..=1024;
    /// Steps between probe refreshes, 1 to 1,000,000.
    probe_every: u32 = 250, in 1..=1_000_000;
    /// Bounces of gathered indirect light, 0 to 8.
    bounces: u32 = 2, in 0..=8, decides Indirect;
    /// Seed of all random choices.
    seed: u64 = 0;
    /// Steps between checkpoints, 1 to 1,000,000.
    checkpoint_every: u32 = 500, in 1..=1_000_000;
    /// Number of restarts of albedo, metalness and roughness, 0 to 5. Restart i comes after (2 i - 1) tenths
    /// of the steps that train materials.
    #[serde(default)]
    albedo_rounds: u32 = 3, in 0..=5;
    /// Maximum number of strong small lights that are separated from a recovered light for sharp shadows, 0
    /// to 4.
    #[serde(default)]
    lights: u32 = 4, in 0..=4;
    /// The training restarts an unknown light together with albedo, by the shading and shadows of neighbouring surfaces. false: only steps change the light.
    #[serde(default)]
    environment_restarts: bool = true;
    /// Takes the light of captures without masks from the surroundings that the photographs show; only what is clipped in
    /// them, such as windows and lamps, is trained. false: the whole light is trained.
    #[serde(default)]
    surrounding_light: bool = true;
    /// Learns metalness. false: every surface is a dielectric.
    #[serde(default = "learned")]
    metalness: bool = true, decides Metalness;
    /// Learns sheen. false: no surface has sheen.
    #[serde(default = "learned")]
    sheen: bool = true, decides Sheen;
    /// Uses the rotations of the light that the capture states. false: trains with a fixed light.
    #[serde(default = "used")]
    light_rotations: bool = true;
    /// Subject that turned in front of a still camera: `auto`, `yes` or `no`. `yes`: the rotations of the light are derived
    /// from the poses. `auto`: derives them if the photographs have masks and the background stands still while the
    /// cameras turn.
    #[serde(default)]
    turntable_capture: TurntableCapture = TurntableCapture::Auto;
    /// Matches photographs with different exposures or white balances, such as those of phones, to a common
    /// one. No effect on captures with a rotating light.
    #[serde(default)]
    match_exposures: bool = true;
    /// Colour of the light in the photographs: `auto`, `neutral`, `daylight`, a number of kelvin or
    /// `[red, green, blue]`.
    #[serde(default = "unknown")]
    white_balance: WhiteBalance = WhiteBalance::AUTO;
    /// Direction in the files of the capture that is up: `auto`, or an axis of the files: `x`, `y`, `z`, `-x`, `-y` or `-z`. The
    /// world is rotated so that this direction is +Z. `auto`: the direction that the layout states, otherwise that of the ground or of the cameras.
    #[serde(default, skip_serializing_if = "UpAxis::is_auto")]
    up: UpAxis = UpAxis::Auto;
    /// Part of the scene that becomes the model, for photographs without masks: `none` (the whole scene),
    /// `auto` (the object on the ground plane, if there is one, in the ball around which the cameras stand)
    /// or a ball `[x, y, z, radius]` in units and axes of the capture after import (+Z up). Content outside
    /// it acts only as a light source.
    #[serde(default = "everything", skip_serializing_if = "is_everything")]
    crop: Crop = Crop::NONE;
    /// Model to train: `3dgs`, `gaussian-shader`, `gs-ir`, `r3dg`, `article` or `relume`. It selects other
    /// settings; settings that the caller gives take precedence.
    #[serde(default, skip_serializing_if = "Method::is_relume")]
    method: Method = Method::Relume;
    /// `auto`: omits the parts of the model that measurements show the scene does not need, except parts that
    /// the caller sets. `full`: all parts.
    #[serde(default)]
    complexity: Complexity = Complexity::Auto;
    groups {
        /// The forward model. Omitted fields are unchanged.
        shading: ShadingOptions changed by ShadingChanges, decides Visibility & Indirect;
        /// Weights of the objective. Omitted fields are unchanged.
        weights: LossWeights changed by LossWeightChanges;
        /// Step sizes. Omitted fields are unchanged.
        rates: LearningRates changed by LearningRateChanges;
    }
}

/// Use of light rotations in files without the field.
fn used() -> bool {
    true
}

/// Metalness and sheen in files without the field.
fn learned() -> bool {
    true
}

/// White balance in files without the field.
fn unknown() -> WhiteBalance {
    WhiteBalance::AUTO
}

/// Crop in files without the field.
fn everything() -> Crop {
    Crop::NONE
}

fn is_everything(crop: &Crop) -> bool {
    *crop == Crop::NONE
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
        Self::on_curve(preset.position())
    }

    /// A preset with a caller's overrides.
    ///
    /// # Errors
    /// Names the invalid field.
    pub fn new(preset: Preset, overrides: &TrainOverrides) -> Result<Self, ConfigError> {
        Self::at(preset.position(), overrides)
    }

    /// A position of the curve ([`Self::on_curve`]) with a caller's overrides.
    ///
    /// # Errors
    /// Names the invalid field.
    pub fn at(position: f32, overrides: &TrainOverrides) -> Result<Self, ConfigError> {
        let mut config = Self::on_curve(position);
        let method: TrainOverrides = serde_json::from_value(overrides.method.unwrap_or_default().overrides())
            .map_err(|error| ConfigError::new("method", error.to_string()))?;
        config.apply(&method);
        config.apply(overrides);
        config.forced = method.forced();
        config.forced.extend(overrides.forced());
        config.forced.sort_unstable();
        config.forced.dedup();
        config.light_rotation_per_photo = overrides.light_rotation_per_photo.clone().unwrap_or_default();
        config.light_groups = overrides.light_groups.clone().unwrap_or_default();
        config.grey_card = overrides.grey_card.clone();
        if config.grey_card.is_some() && overrides.white_balance.is_some() {
            return Err(ConfigError::new("grey_card", "must not be combined with white_balance"));
        }
        config.take_chart(overrides)?;
        if !config.light_rotation_per_photo.is_empty() {
            if config.turntable_capture == TurntableCapture::Yes {
                let reason = "`yes` must not be combined with light_rotation_per_photo";
                return Err(ConfigError::new("turntable_capture", reason));
            }
            config.turntable_capture = TurntableCapture::No;
        }
        (config.time_budget_s, config.until) = (overrides.time_budget_s, overrides.until);
        if config.time_budget_s.is_some() && overrides.iterations.is_some() {
            return Err(ConfigError::new(
                "iterations",
                "must not be combined with time_budget_s, which plans the steps",
            ));
        }
        if let Some(light) = &overrides.light {
            config.hold_light(light);
        }
        config.check()?;
        config.initial_gaussians = config.initial_gaussians.min(config.max_gaussians);
        Ok(config)
    }

    /// Fixes the light to a known one: no step changes it, and no term of the objective acts on it.
    fn hold_light(&mut self, light: &KnownLight) {
        self.light = Some(light.clone());
        self.rates.environment = 0.0;
        (self.weights.light, self.weights.exposure, self.weights.light_colour) = (0.0, 0.0, 0.0);
    }

    /// Checks a configuration that was read from a file.
    ///
    /// # Errors
    /// Names the invalid field.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.check()
    }

    fn check(&self) -> Result<(), ConfigError> {
        if let Some(light) = &self.light {
            light.check()?;
        }
        self.white_balance.check()?;
        self.crop.check(self.warm_up)?;
        self.grey_card.iter().try_for_each(GreyCard::check)?;
        light_groups::check(&self.light_groups)?;
        if self.light.is_some() && !self.light_groups.is_empty() {
            let reason = "must not be combined with light, which is one known light of all photographs";
            return Err(ConfigError::new("light_groups", reason));
        }
        self.colour_chart.iter().try_for_each(ColourChart::check)?;
        if let Some((name, _)) = self.light_rotation_per_photo.iter().find(|(_, turn)| !turn.is_finite()) {
            return Err(ConfigError::new(format!("light_rotation_per_photo.{name}"), "must be finite"));
        }
        if let Some(seconds) = self.time_budget_s {
            check_range("time_budget_s", seconds, TIME_BUDGET)?;
        }
        if self.until.is_some() && self.warm_up_steps() >= self.iterations {
            let reason = "requires materials, which this training does not have: choose a warm_up below 1";
            return Err(ConfigError::new("until", reason));
        }
        self.check_ranges()?;
        if let Some((field, reason)) = self.shading.fault() {
            return Err(ConfigError::new(format!("shading.{field}"), reason));
        }
        check_group("weights", &self.weights)?;
        check_group("rates", &self.rates)
    }

    /// Distance from its target that the colour of the light may have at `progress`, a share of all steps. It is 0 for a
    /// stated colour, and for an estimated one over the first three tenths of the steps that train materials.
    pub fn light_colour_tolerance(&self, progress: f32) -> f32 {
        let until = self.warm_up + ESTIMATE_SHARE * (1.0 - self.warm_up);
        let is_kept = self.white_balance.known().is_some() || progress < until;
        if is_kept { 0.0 } else { ESTIMATE_TOLERANCE }
    }

    /// Source of the initial colour of the light: `light`, `white_balance` or `view_dependence`.
    pub fn colour_source(&self) -> &'static str {
        match (&self.light, self.white_balance.known()) {
            (Some(_), _) => "light",
            (None, Some(_)) => "white_balance",
            (None, None) => "view_dependence",
        }
    }

    /// True if the exposures of the photographs are compared before this step: four times between a fifth and
    /// a half of the steps that train materials.
    pub fn is_exposure_round(&self, step: u32) -> bool {
        let (first, material) = (self.warm_up_steps(), self.iterations - self.warm_up_steps());
        let after = |tenths: u32| u64::from(material) * u64::from(tenths) / 20;
        self.match_exposures
            && step > first
            && [4, 6, 8, 10].iter().any(|t| after(*t) == u64::from(step - first))
    }

    /// Weight of the loss of the radiance branch.
    pub fn radiance_weight(&self, has_alpha: bool) -> f32 {
        if has_alpha { self.weights.radiance } else { UNMASKED_RADIANCE * self.weights.radiance }
    }

    /// Steps of the radiance warm-up.
    pub fn warm_up_steps(&self) -> u32 {
        (self.warm_up * self.iterations as f32) as u32
    }

    /// True if albedo restarts before this step.
    pub fn is_albedo_round(&self, step: u32) -> bool {
        let first = self.warm_up_steps();
        let after = |round: u32| u64::from(self.iterations - first) * u64::from(2 * round + 1) / 10;
        step > first && (0..self.albedo_rounds).any(|round| after(round) == u64::from(step - first))
    }
}

#[cfg(test)]
mod tests;
