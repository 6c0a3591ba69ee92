//! Settings with named values.

use serde::{Deserialize, Serialize};

/// Preset: named compromise between training time and quality. `draft`: a first result within a few minutes.
/// `standard`: the default. `high`: the most steps, pixels and Gaussians.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default, utoipa::ToSchema)]
#[cfg_attr(feature = "sqlx", derive(sqlx::Type), sqlx(type_name = "text", rename_all = "snake_case"))]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// A first result within a few minutes.
    Draft,
    /// The default.
    #[default]
    Standard,
    /// The most steps, pixels and Gaussians.
    High,
}

/// Source of the visibility labels. `none`: no labels, only the photometric gradient. `backward`: backward
/// transmittance along camera rays. `probes`: transmittance probes over the sphere. `both`: `backward` and
/// `probes`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LabelSource {
    /// No labels, only the photometric gradient.
    None,
    /// Backward transmittance along camera rays, as in the article (Eq. 14-15; docs/MODEL.md section 6).
    Backward,
    /// Transmittance probes over the sphere.
    #[default]
    Probes,
    /// Backward transmittance and probes.
    Both,
}

/// Direction in the files of a capture that is up. `auto`: the direction that the layout states, otherwise that of the ground or of the cameras.
/// `x`, `y`, `z`, `-x`, `-y`, `-z`: an axis of the files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default, utoipa::ToSchema)]
pub enum UpAxis {
    /// The direction that the layout states, otherwise that of the ground or of the cameras.
    #[default]
    #[serde(rename = "auto")]
    Auto,
    /// +X.
    #[serde(rename = "x")]
    X,
    /// +Y.
    #[serde(rename = "y")]
    Y,
    /// +Z.
    #[serde(rename = "z")]
    Z,
    /// -X.
    #[serde(rename = "-x")]
    NegX,
    /// -Y.
    #[serde(rename = "-y")]
    NegY,
    /// -Z.
    #[serde(rename = "-z")]
    NegZ,
}

impl UpAxis {
    /// True for [`UpAxis::Auto`].
    pub fn is_auto(&self) -> bool {
        *self == Self::Auto
    }
}

/// Whether the subject of a capture turned in front of a still camera, as on a turntable, so that the light of the photographs
/// rotates with the camera. `auto`: by evidence. `yes`, `no`: stated by the caller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TurntableCapture {
    /// Yes if the background stands still while the cameras turn.
    #[default]
    Auto,
    /// The light rotates with the camera.
    Yes,
    /// The light rotates only as the files state.
    No,
}

/// Complexity of the model. `auto`: the parts that measurements show the scene needs. `full`: all configured
/// parts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Complexity {
    /// The parts that measurements show the scene needs. The model card records evidence and decisions.
    Auto,
    /// All configured parts.
    #[default]
    Full,
}

/// A setting that [`Complexity::Auto`] decides. Stored files list [`forced`](super::TrainConfig::forced) in
/// this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ComplexitySetting {
    /// SH degree of the visibility field, or no visibility.
    Visibility,
    /// Indirect light.
    Indirect,
    /// SH degree of the radiance branch.
    Radiance,
    /// Metalness: learned, or fixed at dielectric.
    Metalness,
    /// Sheen: learned, or none.
    Sheen,
    /// Number of albedo prototypes.
    Prototypes,
    /// Number of Gaussians.
    Gaussians,
}
