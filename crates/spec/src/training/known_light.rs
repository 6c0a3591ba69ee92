//! A known light of the photographs.

use serde::{Deserialize, Serialize};

use crate::training::ConfigError;

/// Maximum length of an environment's name, characters.
const MAX_NAME_CHARACTERS: usize = 1024;
/// Maximum magnitude of the exposure, stops.
pub const MAX_STOPS: f64 = 20.0;

/// A measured light. Training keeps it fixed and recovers no light.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct KnownLight {
    /// Name of a built-in map, or identifier of an uploaded environment map, 1 to 1,024 characters. On the
    /// command line also a file.
    pub environment: String,
    /// Rotation of the map about the capture's +Z, degrees, counter-clockwise seen from above. Omitted: 0.
    #[serde(default)]
    pub rotation_deg: f64,
    /// Exposure of the map. Omitted: 0 stops.
    #[serde(default)]
    pub exposure_ev: LightExposure,
}

/// Exposure of a known light: a number of stops or `auto`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(untagged, expecting = "must be a number of stops or \"auto\"")]
pub enum LightExposure {
    /// Stops, -20 to 20: the map is multiplied by two to this power. At 0, a surface of radiance 1 is white
    /// in the photographs.
    Stops(f64),
    /// Unknown exposure: the map is scaled so that a white surface that faces up has a luminance of 0.9 of
    /// white. A recovered light is kept near the same level.
    Unknown(Auto),
}

/// The string `auto`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Auto {
    /// `auto`.
    Auto,
}

impl LightExposure {
    /// Unknown exposure.
    pub const AUTO: Self = Self::Unknown(Auto::Auto);
}

impl Default for LightExposure {
    fn default() -> Self {
        Self::Stops(0.0)
    }
}

impl KnownLight {
    /// # Errors
    /// Names the invalid field.
    pub fn check(&self) -> Result<(), ConfigError> {
        if self.environment.is_empty() || self.environment.chars().count() > MAX_NAME_CHARACTERS {
            let reason = format!("must have 1 to {MAX_NAME_CHARACTERS} characters");
            return Err(ConfigError::new("light.environment", reason));
        }
        if !self.rotation_deg.is_finite() {
            return Err(ConfigError::new("light.rotation_deg", "must be finite"));
        }
        match self.exposure_ev {
            LightExposure::Stops(ev) if !(-MAX_STOPS..=MAX_STOPS).contains(&ev) => {
                let reason = format!("must be -{MAX_STOPS} to {MAX_STOPS}, or \"auto\"");
                Err(ConfigError::new("light.exposure_ev", reason))
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn light(exposure_ev: LightExposure) -> KnownLight {
        KnownLight { environment: "sky".into(), rotation_deg: 0.0, exposure_ev }
    }

    #[test]
    fn exposure_is_a_finite_number_or_auto() {
        let read = |text: &str| serde_json::from_str::<KnownLight>(text).map(|l| l.exposure_ev);
        let with = |value: &str| read(&format!(r#"{{"environment": "sky", "exposure_ev": {value}}}"#));
        assert_eq!(with("-1.5").unwrap(), LightExposure::Stops(-1.5));
        assert_eq!(with(r#""auto""#).unwrap(), LightExposure::AUTO);
        assert_eq!(read(r#"{"environment": "sky"}"#).unwrap(), LightExposure::Stops(0.0));
        assert!(with(r#""bright""#).unwrap_err().to_string().contains("stops or \"auto\""));
        assert!(light(LightExposure::Stops(f64::NAN)).check().is_err_and(|e| e.field == "light.exposure_ev"));
        assert!(light(LightExposure::AUTO).check().is_ok());
    }
}
