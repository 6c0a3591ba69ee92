//! Settings with a few named values.

use serde::{Deserialize, Serialize};

/// A named trade of time against quality.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[cfg_attr(
    feature = "server",
    derive(utoipa::ToSchema, sqlx::Type),
    sqlx(type_name = "text", rename_all = "snake_case")
)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// A look at the result within a few minutes.
    Draft,
    /// The default.
    #[default]
    Standard,
    /// The most steps, pixels and Gaussians.
    High,
}

/// Where visibility is learned from (article Eq. 14-15; docs/MODEL.md section 6).
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

/// How much of the configured model a scene gets.
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

/// What [`Complexity::Auto`] decides on. The order is that of [`forced`](super::TrainConfig::forced) in stored files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ComplexitySetting {
    /// Degree of the visibility field, or no visibility at all.
    Visibility,
    /// Bounced light.
    Indirect,
    /// Degree of the radiance branch.
    Radiance,
    /// Metalness, learned or held at dielectric.
    Metalness,
    /// Sheen, learned or none.
    Sheen,
    /// Number of albedo prototypes.
    Prototypes,
    /// Number of Gaussians.
    Gaussians,
}
