//! The planes of a frame.

use serde::{Deserialize, Serialize};

/// A plane that a caller can request. The numbers of floats per pixel are in parentheses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Output {
    /// Relit linear radiance, premultiplied by alpha (3).
    Rgb,
    /// Linear base colour (3).
    Albedo,
    /// World-space unit normal; zero in empty pixels (3).
    Normal,
    /// Metalness (1).
    #[serde(alias = "metalness")]
    Metallic,
    /// Roughness (1).
    Roughness,
    /// Ambient occlusion, 1 = open (1).
    #[serde(alias = "ao", alias = "ambient_occlusion")]
    Visibility,
    /// Distance along the view axis, capture units; infinite in empty pixels (1).
    Depth,
    /// Coverage (1).
    Alpha,
    /// Diffuse part of `rgb`, premultiplied (3).
    Diffuse,
    /// Specular part of `rgb`, premultiplied (3).
    Specular,
    /// The radiance branch: the scene under its own light, linear, premultiplied (3).
    Radiance,
}

impl Output {
    /// Floats per pixel.
    pub fn channels(self) -> usize {
        match self {
            Self::Rgb | Self::Albedo | Self::Normal | Self::Diffuse | Self::Specular | Self::Radiance => 3,
            Self::Metallic | Self::Roughness | Self::Visibility | Self::Depth | Self::Alpha => 1,
        }
    }
}
