//! Which part of an unmasked capture becomes the model.

use serde::{Deserialize, Serialize};

use crate::train::config::error::ConfigError;

/// Which part of the photographs becomes the model; what lies outside only lights it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(untagged, expecting = "must be \"none\", \"auto\" or [x, y, z, radius]")]
pub enum Crop {
    /// By name.
    Named(NamedCrop),
    /// Centre and radius of a ball, units and axes of the capture after import (+Z up).
    Ball([f64; 4]),
}

/// A crop by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum NamedCrop {
    /// Everything in the photographs.
    None,
    /// What stands on the ground, if there is one, in the ball around which the cameras stand.
    Auto,
}

impl Crop {
    /// Everything in the photographs.
    pub const NONE: Self = Self::Named(NamedCrop::None);

    /// # Errors
    /// Says what is out of range.
    pub(super) fn check(self, warm_up: f32) -> Result<(), ConfigError> {
        let refuse = |reason: &str| Err(ConfigError::new("crop", reason));
        match self {
            Self::Named(NamedCrop::None) => Ok(()),
            _ if warm_up <= 0.0 || warm_up >= 1.0 => refuse("needs a warm_up between 0 and 1"),
            Self::Ball(ball) if !ball.iter().all(|v| v.is_finite()) || ball[3] <= 0.0 => {
                refuse("must be finite, its radius above 0")
            }
            _ => Ok(()),
        }
    }
}

impl std::str::FromStr for Crop {
    type Err = String;

    /// `none`, `auto`, or four numbers with commas between them.
    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || "must be none, auto or X,Y,Z,RADIUS".to_owned();
        match text {
            "none" => Ok(Self::NONE),
            "auto" => Ok(Self::Named(NamedCrop::Auto)),
            _ => {
                let numbers: Result<Vec<f64>, _> = text.split(',').map(|n| n.trim().parse()).collect();
                let ball = numbers.ok().and_then(|numbers| numbers.try_into().ok());
                ball.map(Self::Ball).ok_or_else(wrong)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::{Preset, TrainConfig, TrainOverrides};

    #[test]
    fn names_and_balls_are_read_and_nonsense_is_refused() {
        assert_eq!("none".parse(), Ok(Crop::NONE));
        assert_eq!("auto".parse(), Ok(Crop::Named(NamedCrop::Auto)));
        assert_eq!("0, -1.5,2,3".parse(), Ok(Crop::Ball([0.0, -1.5, 2.0, 3.0])));
        for text in ["", "all", "1,2,3", "1,2,3,4,5", "1,2,3,x"] {
            assert!(text.parse::<Crop>().is_err(), "{text}");
        }
        let read = |json: &str| serde_json::from_str::<Crop>(json);
        assert_eq!(read("\"auto\"").unwrap(), Crop::Named(NamedCrop::Auto));
        assert_eq!(read("[0, 0, 1, 2]").unwrap(), Crop::Ball([0.0, 0.0, 1.0, 2.0]));
        assert!(read("[0, 0, 1]").unwrap_err().to_string().contains("must be \"none\""));
    }

    #[test]
    fn a_crop_is_refused_where_it_cannot_be_found_or_is_no_ball() {
        let refused = |json: &str| {
            let overrides: TrainOverrides = serde_json::from_str(json).unwrap();
            TrainConfig::new(Preset::Draft, &overrides).map_err(|error| error.field)
        };
        assert_eq!(refused(r#"{"crop": [0, 0, 0, 0]}"#).unwrap_err(), "crop");
        assert_eq!(refused(r#"{"crop": "auto", "warm_up": 0}"#).unwrap_err(), "crop");
        assert_eq!(refused(r#"{"crop": "auto", "method": "3dgs"}"#).unwrap_err(), "crop");
        assert!(
            refused(r#"{"crop": "auto"}"#).is_ok() && refused(r#"{"warm_up": 0}"#).is_ok(),
            "the control"
        );
    }
}
