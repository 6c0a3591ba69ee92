//! Kinds of image files.

use serde::{Deserialize, Serialize};

use crate::render::Output;

/// A kind of image file.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum FrameFormat {
    /// One output, display-referred or mapped to integers.
    #[default]
    Png,
    /// One output over white.
    Jpeg,
    /// Every output, linear floats.
    Exr,
}

impl FrameFormat {
    /// Every kind.
    pub const ALL: [Self; 3] = [Self::Png, Self::Jpeg, Self::Exr];

    /// What its files end in, without the point.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Jpeg => "jpg",
            Self::Exr => "exr",
        }
    }

    /// Media type.
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Png => "image/png",
            Self::Jpeg => "image/jpeg",
            Self::Exr => "image/x-exr",
        }
    }
}

/// True when the output is a colour, which JPEG can hold.
pub fn is_colour(output: Output) -> bool {
    use Output::{Albedo, Diffuse, Radiance, Rgb, Specular};
    matches!(output, Rgb | Albedo | Diffuse | Specular | Radiance)
}
