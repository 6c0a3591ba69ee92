//! Quantity stored as the colour of exported Gaussians.

use serde::{Deserialize, Serialize};

/// Quantity stored as the colour of exported Gaussians.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ExportedColour {
    /// Radiance as in the photographs.
    Radiance,
    /// The model relit with an environment map.
    Relit,
    /// Base colour.
    Albedo,
    /// Shading normals, encoded as `n / 2 + 1/2`.
    Normal,
    /// Roughness.
    Roughness,
    /// Metalness.
    Metallic,
}
