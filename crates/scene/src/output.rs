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
    /// The part of `shadow` that is light of the strong small lights; `shadow` is the sum of this plane and `shadow_fill` (3).
    ShadowKey,
    /// The part of `shadow` that is light of the rest of the map (3).
    ShadowFill,
    /// Radiance of a white diffuse ground under the lamps alone, with the shadow of the model; 0 without ground (3).
    LampLight,
    /// Share of the light of the lamps that reaches the ground past the model, per channel; 1 where no lamp shines (3).
    LampShadow,
    /// Confidence in the materials of the surface, 0 to 1; 0 in empty pixels (1).
    Confidence,
    /// Where the point of the surface is in the next and in the previous frame of a sequence, pixels to the right and upwards from
    /// where it is in this one; zero in empty pixels (4).
    Motion,
    /// Number of the material of which the surface has most; -1 in empty pixels (1).
    MaterialId,
    /// Identifier and coverage of up to six materials, in the order of coverage, as Cryptomatte stores them (12).
    Cryptomatte,
}

impl Output {
    /// Floats per pixel.
    pub fn channels(self) -> usize {
        match self {
            Self::Rgb | Self::Albedo | Self::Normal | Self::Diffuse | Self::Specular | Self::Radiance => 3,
            Self::Position
            | Self::Shadow
            | Self::ShadowKey
            | Self::ShadowFill
            | Self::Bounce
            | Self::LampLight
            | Self::LampShadow => 3,
            Self::Metallic
            | Self::Roughness
            | Self::Visibility
            | Self::Depth
            | Self::Alpha
            | Self::Contact
            | Self::Confidence
            | Self::MaterialId => 1,
            Self::Motion => 4,
            Self::Cryptomatte => 12,
        }
    }

    /// Whether only EXR can store this plane: coordinates, identifiers, and planes of more than three channels.
    pub fn is_exr_only(self) -> bool {
        matches!(self, Self::Position | Self::Motion | Self::MaterialId | Self::Cryptomatte)
    }

    /// Whether this plane shows the materials of the model.
    pub fn is_of_materials(self) -> bool {
        matches!(self, Self::MaterialId | Self::Cryptomatte)
    }

    /// Whether the ground below the model has this plane, and not the model.
    pub fn is_of_ground(self) -> bool {
        let is_of_map =
            matches!(self, Self::Shadow | Self::ShadowKey | Self::ShadowFill | Self::Bounce | Self::Contact);
        is_of_map || self.is_of_lamps_on_ground()
    }

    /// Whether this plane is light of lamps on the ground.
    pub fn is_of_lamps_on_ground(self) -> bool {
        matches!(self, Self::LampLight | Self::LampShadow)
    }

    /// Whether this plane shows lamps, on the model or on the ground.
    pub fn shows_lamps(self) -> bool {
        matches!(self, Self::Rgb | Self::Diffuse | Self::Specular) || self.is_of_lamps_on_ground()
    }
}
