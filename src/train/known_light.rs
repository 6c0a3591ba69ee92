//! The measured light of the photographs, where it is known.

use serde::{Deserialize, Serialize};

use crate::capture::Capture;
use crate::engine::upward_share;
use crate::light::{UPWARD_LUMINANCE, luminance};
use crate::scene::{EnvMap, texel_directions};
use crate::train::config::error::ConfigError;

/// Most characters of an environment's name.
const MOST_CHARACTERS: usize = 1024;
/// Largest exposure either way, stops.
const MOST_STOPS: f64 = 20.0;
/// Distance from the usual level beyond which a map is likely on another scale than the photographs, stops.
const MOST_OFFSET: f64 = 1.0;

/// A measured light: training holds it and does not recover one beside the materials.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct KnownLight {
    /// A built-in map, an uploaded environment's identifier, or on the command line a file.
    pub environment: String,
    /// Rotation of the map about the capture's +Z, degrees counter-clockwise seen from above.
    #[serde(default)]
    pub rotation_deg: f64,
    /// Exposure of the map.
    #[serde(default)]
    pub exposure_ev: LightExposure,
}

/// Radiance of the map in the photographs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(untagged, expecting = "must be a number of stops or \"auto\"")]
pub enum LightExposure {
    /// The map times two to this, -20 to 20: at 0, a surface of radiance 1 is white in the photographs.
    Stops(f64),
    /// Not known: the map is scaled so that a white surface facing up has a luminance of 0.9 of white. A recovered light is held near the same level.
    Unknown(Auto),
}

/// The string `auto`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Auto {
    /// `auto`.
    Auto,
}

impl LightExposure {
    /// Exposure from the map itself.
    pub const AUTO: Self = Self::Unknown(Auto::Auto);
}

impl Default for LightExposure {
    fn default() -> Self {
        Self::Stops(0.0)
    }
}

impl KnownLight {
    /// # Errors
    /// Names the field that is out of range.
    pub(super) fn check(&self) -> Result<(), ConfigError> {
        if self.environment.is_empty() || self.environment.chars().count() > MOST_CHARACTERS {
            let reason = format!("must have 1 to {MOST_CHARACTERS} characters");
            return Err(ConfigError::new("light.environment", reason));
        }
        if !self.rotation_deg.is_finite() {
            return Err(ConfigError::new("light.rotation_deg", "must be finite"));
        }
        match self.exposure_ev {
            LightExposure::Stops(ev) if !(-MOST_STOPS..=MOST_STOPS).contains(&ev) => {
                let reason = format!("must be -{MOST_STOPS} to {MOST_STOPS}, or \"auto\"");
                Err(ConfigError::new("light.exposure_ev", reason))
            }
            _ => Ok(()),
        }
    }

    /// Gives `capture` the measured map, with a warning if it is likely on another scale than the photographs.
    pub fn illuminate(&self, capture: &mut Capture, map: EnvMap) {
        if let LightExposure::Stops(ev) = self.exposure_ev {
            let off = level(&map).log2() + ev;
            if off.abs() > MOST_OFFSET {
                capture.warnings.push(format!(
                    "light: under it a white surface facing up is {off:+.1} stops from where photographs show it; a map on another scale \
                     than the photographs spoils albedo (exposure \"auto\" assumes 0)"
                ));
            }
        }
        capture.lit_by = Some(map);
    }

    /// `map` at the rotation and exposure of the photographs.
    pub(super) fn applied(&self, map: &EnvMap) -> EnvMap {
        let gain = match self.exposure_ev {
            LightExposure::Stops(ev) => ev.exp2(),
            // At most the largest exposure in stops: a map that is dark above stays finite.
            LightExposure::Unknown(Auto::Auto) => level(map).recip().min(MOST_STOPS.exp2()),
        };
        map.rotated_and_scaled(self.rotation_deg, gain as f32)
    }
}

/// Luminance of a white horizontal surface facing up, over that which an unknown light is held to; never 0.
fn level(map: &EnvMap) -> f64 {
    let texels = map.texels().iter().zip(texel_directions(map.width(), map.height()));
    let level: f64 = texels.map(|(t, at)| f64::from(upward_share(&at) * luminance(*t))).sum();
    (level / f64::from(UPWARD_LUMINANCE)).max(1e-9)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn light(exposure_ev: LightExposure) -> KnownLight {
        KnownLight { environment: "sky".into(), rotation_deg: 0.0, exposure_ev }
    }

    #[test]
    fn an_unknown_exposure_makes_white_white_and_a_given_one_is_kept() {
        let sky = EnvMap::from_fn(64, 32, |d| [3.0 * (d.z.max(0.0) as f32), 0.5, 0.25]);
        let expected = luminance([2.0, 0.5, 0.25]) / UPWARD_LUMINANCE;
        assert!((level(&sky) - f64::from(expected)).abs() < 5e-3);
        assert!((level(&light(LightExposure::AUTO).applied(&sky)) - 1.0).abs() < 1e-6);
        let floor = EnvMap::from_fn(8, 4, |d| [if d.z < 0.0 { 1e30 } else { 0.0 }; 3]);
        let lit = light(LightExposure::AUTO).applied(&floor);
        assert!(
            lit.texels().iter().flatten().all(|v| v.is_finite()),
            "nothing from above is no reason for infinity"
        );
        let given = light(LightExposure::Stops(2.0)).applied(&sky);
        assert!((level(&given) / level(&sky) - 4.0).abs() < 1e-5);
    }

    #[test]
    fn the_exposure_is_a_number_or_auto() {
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
