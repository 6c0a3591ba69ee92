//! Crop: the part of a capture without masks that becomes the model.

use serde::{Deserialize, Serialize};

use crate::training::ConfigError;

/// Part of the scene that becomes the model. Content outside it acts only as a light source.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(untagged, expecting = "must be \"none\", \"auto\" or [x, y, z, radius]")]
pub enum Crop {
    /// By name.
    Named(NamedCrop),
    /// A ball `[x, y, z, radius]` in units and axes of the capture after import (+Z up).
    Ball([f64; 4]),
}

/// Named crop. `none`: the whole scene. `auto`: the object on the ground plane, if there is one, in the ball
/// around which the cameras stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum NamedCrop {
    /// The whole scene.
    None,
    /// The object on the ground plane, if there is one, in the ball around which the cameras stand.
    Auto,
}

impl Crop {
    /// The whole scene.
    pub const NONE: Self = Self::Named(NamedCrop::None);

    /// # Errors
    /// The reason if the crop is invalid.
    pub(super) fn check(self, warm_up: f32) -> Result<(), ConfigError> {
        let refuse = |reason: &str| Err(ConfigError::new("crop", reason));
        match self {
            Self::Named(NamedCrop::None) => Ok(()),
            _ if warm_up <= 0.0 || warm_up >= 1.0 => refuse("requires a warm_up more than 0 and less than 1"),
            Self::Ball(ball) if !ball.iter().all(|v| v.is_finite()) || ball[3] <= 0.0 => {
                refuse("must be finite, with a radius above 0")
            }
            _ => Ok(()),
        }
    }
}

impl std::str::FromStr for Crop {
    type Err = String;

    /// Parses `none`, `auto` or four numbers separated by commas.
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
    use crate::training::{Preset, TrainConfig, TrainOverrides};

    #[test]
    fn crop_names_and_balls_parse_and_other_text_is_refused() {
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
    fn crop_without_radius_or_without_warm_up_is_refused() {
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
