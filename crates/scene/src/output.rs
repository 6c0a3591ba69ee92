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
    /// Point of the surface, capture units; zero in empty pixels (3).
    Position,
    /// Share of the light that reaches the ground past the model, per channel; 1 without ground (3).
    Shadow,
    /// Light that the model sends to the ground, as a share of the light that reaches the ground without the model, per channel; 0 without
    /// ground (3).
    Bounce,
    /// Ambient occlusion of the ground by the model, 1 = open (1).
    Contact,
    /// Confidence in the materials of the surface, 0 to 1; 0 in empty pixels (1).
    Confidence,
}

impl Output {
    /// Floats per pixel.
    pub fn channels(self) -> usize {
        match self {
            Self::Rgb | Self::Albedo | Self::Normal | Self::Diffuse | Self::Specular | Self::Radiance => 3,
            Self::Position | Self::Shadow | Self::Bounce => 3,
            Self::Metallic
            | Self::Roughness
            | Self::Visibility
            | Self::Depth
            | Self::Alpha
            | Self::Contact
            | Self::Confidence => 1,
        }
    }

    /// Whether the ground below the model has this plane, and not the model.
    pub fn is_of_ground(self) -> bool {
        matches!(self, Self::Shadow | Self::Bounce | Self::Contact)
    }
}
