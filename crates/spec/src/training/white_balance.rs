//! Colour of the light in the photographs.

use serde::{Deserialize, Serialize};

use crate::training::ConfigError;
use relume_scene::light::{DAYLIGHT, LightColour};

/// Accepted colour temperatures, kelvin.
const KELVIN: std::ops::RangeInclusive<f32> = 2_000.0..=20_000.0;

/// Colour of the light in the photographs: the colour of a white surface that receives all of the light.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(
    untagged,
    expecting = "must be \"auto\", \"neutral\", \"daylight\", a number of kelvin or [red, green, blue]"
)]
pub enum WhiteBalance {
    /// By name.
    Named(NamedBalance),
    /// Colour temperature of the light in photographs that are balanced for daylight (6,504 K), 2,000 to
    /// 20,000 K.
    Kelvin(f32),
    /// Linear Rec.709 colour of a white or grey surface in the photographs, 0.0001 to 10,000 per channel.
    /// Only the ratios matter.
    Colour([f32; 3]),
}

/// Named colour of the light. `auto`: unknown, estimated from the view dependence of colours; the training
/// may change it by the error of the estimate. `neutral`: white surfaces are grey in the photographs, which are balanced for their light.
/// `daylight`: an open sky, in photographs that are balanced for the sun.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum NamedBalance {
    /// Unknown: estimated from the view dependence of colours. The training may change it by the error of the estimate.
    Auto,
    /// White surfaces are grey in the photographs, which are balanced for their light.
    Neutral,
    /// An open sky, in photographs that are balanced for the sun.
    Daylight,
}

impl WhiteBalance {
    /// Unknown colour.
    pub const AUTO: Self = Self::Named(NamedBalance::Auto);
    /// White surfaces are grey in the photographs.
    pub const NEUTRAL: Self = Self::Named(NamedBalance::Neutral);

    /// The colour, if it is known.
    pub fn known(self) -> Option<LightColour> {
        match self {
            Self::Named(NamedBalance::Auto) => None,
            Self::Named(NamedBalance::Neutral) => Some(LightColour::NEUTRAL),
            Self::Named(NamedBalance::Daylight) => Some(LightColour::of(DAYLIGHT)),
            Self::Kelvin(kelvin) => Some(LightColour::black_body(kelvin)),
            Self::Colour(rgb) => Some(LightColour::of(rgb)),
        }
    }

    /// # Errors
    /// The reason if a value is out of range.
    pub(super) fn check(self) -> Result<(), ConfigError> {
        let refuse = |reason: &str| Err(ConfigError::new("white_balance", reason));
        match self {
            Self::Kelvin(kelvin) if !KELVIN.contains(&kelvin) => refuse("must be 2000 to 20000 kelvin"),
            Self::Colour(rgb) if !rgb.iter().all(|v| (1e-4..=1e4).contains(v)) => {
                refuse("each channel must be 0.0001 to 10000")
            }
            _ => Ok(()),
        }
    }
}

impl std::str::FromStr for WhiteBalance {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let quoted = serde_json::Value::from(text).to_string();
        serde_json::from_str(text)
            .or_else(|_| serde_json::from_str(&quoted))
            .map_err(|error| error.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn white_balance_parses_words_kelvin_and_colours_only() {
        let read = |text: &str| text.parse::<WhiteBalance>();
        assert_eq!(read("auto"), Ok(WhiteBalance::AUTO));
        assert_eq!(read("neutral").unwrap().known(), Some(LightColour::NEUTRAL));
        assert_eq!(read("3200"), Ok(WhiteBalance::Kelvin(3_200.0)));
        assert_eq!(read("[1, 0.5, 0.25]"), Ok(WhiteBalance::Colour([1.0, 0.5, 0.25])));
        assert!(read("3200").unwrap().known().unwrap().blue_over_red < -1.0, "tungsten is warm");
        assert!(read("daylight").unwrap().known().unwrap().blue_over_red > 0.4);
        assert!(read("tungsten").unwrap_err().contains("kelvin"));
        for bad in ["12", "1e9", "[0, 1, 1]"] {
            assert_eq!(read(bad).unwrap().check().unwrap_err().field, "white_balance", "{bad}");
        }
    }
}
