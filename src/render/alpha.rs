//! Whether colours are multiplied with their coverage.

use serde::{Deserialize, Serialize};

/// Whether the colours of an EXR are multiplied with alpha. PNG has straight alpha always.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AlphaMode {
    /// They are, as OpenEXR and compositing programs expect; base colour, which is a measurement, is not.
    #[default]
    Premultiplied,
    /// They are not: the colour of what there is in a pixel, however little.
    Straight,
}

impl AlphaMode {
    /// What the attribute `relume:alpha` of an EXR says.
    pub(super) fn note(self) -> &'static str {
        match self {
            Self::Premultiplied => "colours are premultiplied, base colour is not",
            Self::Straight => "colours are straight",
        }
    }

    /// A premultiplied colour in this mode. Straight, a pixel without coverage is black.
    pub(super) fn of_premultiplied(self, colour: [f32; 3], alpha: f32) -> [f32; 3] {
        match self {
            Self::Premultiplied => colour,
            Self::Straight if alpha > 0.0 => colour.map(|v| v / alpha),
            Self::Straight => [0.0; 3],
        }
    }
}
