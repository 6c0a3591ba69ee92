//! Image file formats.

use serde::{Deserialize, Serialize};

use relume_scene::Output;

/// Image file format. `png`: one output, display-referred or mapped to integers. `jpeg`: one output over
/// white. `exr`: all outputs, linear floats.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FrameFormat {
    /// One output, display-referred or mapped to integers.
    #[default]
    Png,
    /// One output over white.
    Jpeg,
    /// All outputs, linear floats.
    Exr,
}

impl FrameFormat {
    /// All formats.
    pub const ALL: [Self; 3] = [Self::Png, Self::Jpeg, Self::Exr];

    /// File name extension without the dot.
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

/// True if the output is a colour. JPEG holds only colours.
pub fn is_colour(output: Output) -> bool {
    use Output::{Albedo, Diffuse, Radiance, Rgb, Specular};
    matches!(output, Rgb | Albedo | Diffuse | Specular | Radiance)
}
