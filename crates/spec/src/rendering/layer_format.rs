//! Files of the layers of a photograph.

use serde::{Deserialize, Serialize};

/// Files of the layers of a photograph. `exr`: one OpenEXR with all layers, linear half floats. `png`: a PNG for
/// each layer, 8 bit with the sRGB curve. Alpha is straight in both.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LayerFormat {
    /// One OpenEXR with all layers, linear half floats, straight alpha.
    #[default]
    Exr,
    /// A PNG for each layer: 8 bit with the sRGB curve and straight alpha.
    Png,
}

impl LayerFormat {
    /// File name extension without the dot.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Exr => "exr",
            Self::Png => "png",
        }
    }
}
