//! Alpha mode of colours.

use serde::{Deserialize, Serialize};

/// Alpha mode of the colours of an EXR. PNG always has straight alpha.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AlphaMode {
    /// Colours are multiplied by alpha, as OpenEXR and compositing programs expect. Base colour is not,
    /// because it is a measurement.
    #[default]
    Premultiplied,
    /// Colours are not multiplied by alpha: the colour of the covered part of a pixel, at any coverage.
    Straight,
}

impl AlphaMode {
    /// Value of the attribute `relume:alpha` of an EXR.
    pub fn note(self) -> &'static str {
        match self {
            Self::Premultiplied => "colours are premultiplied, base colour is not",
            Self::Straight => "colours are straight",
        }
    }

    /// Converts a premultiplied colour to this mode. A straight colour with alpha 0 is black.
    pub fn of_premultiplied(self, colour: [f32; 3], alpha: f32) -> [f32; 3] {
        match self {
            Self::Premultiplied => colour,
            Self::Straight if alpha > 0.0 => colour.map(|v| v / alpha),
            Self::Straight => [0.0; 3],
        }
    }
}
