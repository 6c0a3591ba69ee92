//! The light that the photographs were taken in, where somebody measured it.

use serde::{Deserialize, Serialize};

use crate::capture::Capture;
use crate::scene::{EnvMap, texel_directions};
use crate::train::objective::material::upward;

/// Most characters of an environment's name.
const LONGEST_NAME: usize = 1024;
/// Largest exposure either way, stops.
const MOST_STOPS: f64 = 20.0;
/// Further than this from the usual level a map is likely on another scale than the photographs, stops.
const SUSPICIOUS: f64 = 1.0;

/// A measured light: training holds it, instead of recovering one beside the materials.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct KnownLight {
    /// A built-in map, an uploaded environment's identifier, or on the command line a file.
    pub environment: String,
    /// Turn of the map about the capture's +Z, degrees counter-clockwise seen from above.
    #[serde(default)]
    pub rotation_deg: f64,
    /// Exposure of the map.
    #[serde(default)]
    pub exposure_ev: LightExposure,
}

/// What a map's radiance is in the photographs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(untagged, expecting = "must be a number of stops or \"auto\"")]
pub enum LightExposure {
    /// Times two to this, -20 to 20: at 0, a surface that sends a radiance of 1 is white in the photographs.
    Stops(f64),
    /// Not known: such that a white surface facing up is white, the level that a recovered light is held near, too.
    Unknown(Auto),
}

/// The word `auto`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Auto {
    /// The only one.
    Auto,
}

impl LightExposure {
    /// Found, not told.
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
    pub(super) fn check(&self) -> Result<(), String> {
        if self.environment.is_empty() || self.environment.chars().count() > LONGEST_NAME {
            return Err(format!("light.environment: must have 1 to {LONGEST_NAME} characters"));
        }
        if !self.rotation_deg.is_finite() {
            return Err("light.rotation_deg: must be finite".into());
        }
        match self.exposure_ev {
            LightExposure::Stops(ev) if !(-MOST_STOPS..=MOST_STOPS).contains(&ev) => {
                Err(format!("light.exposure_ev: must be -{MOST_STOPS} to {MOST_STOPS}, or \"auto\""))
            }
            _ => Ok(()),
        }
    }

    /// Gives `capture` the map, as it was measured; one that is likely on another scale is warned of.
    pub fn illuminate(&self, capture: &mut Capture, map: EnvMap) {
        if let LightExposure::Stops(ev) = self.exposure_ev {
            let off = level(&map).log2() + ev;
            if off.abs() > SUSPICIOUS {
                capture.warnings.push(format!(
                    "light: under it a white surface facing up is {off:+.1} stops from white; a map on another scale \
                     than the photographs spoils albedo (exposure \"auto\" assumes 0)"
                ));
            }
        }
        capture.lit_by = Some(map);
    }

    /// `map` as the photographs saw it.
    pub(super) fn applied(&self, map: &EnvMap) -> EnvMap {
        let gain = match self.exposure_ev {
            LightExposure::Stops(ev) => ev.exp2(),
            // As far as a told exposure may go: what only shines from below stays finite.
            LightExposure::Unknown(Auto::Auto) => level(map).recip().min(MOST_STOPS.exp2()),
        };
        map.rotated_and_scaled(self.rotation_deg, gain as f32)
    }
}

/// Radiance of a white horizontal surface facing up, mean of the channels; never 0.
fn level(map: &EnvMap) -> f64 {
    let texels = map.texels().iter().zip(texel_directions(map.width(), map.height()));
    let level: f64 = texels.map(|(t, at)| f64::from(upward(&at)) * mean(t)).sum();
    level.max(1e-9)
}

fn mean(t: &[f32; 3]) -> f64 {
    t.iter().map(|v| f64::from(*v)).sum::<f64>() / 3.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn light(exposure_ev: LightExposure) -> KnownLight {
        KnownLight { environment: "sky".into(), rotation_deg: 0.0, exposure_ev }
    }

    #[test]
    fn an_unknown_exposure_makes_white_white_and_a_told_one_is_kept() {
        let sky = EnvMap::from_fn(64, 32, |d| [3.0 * (d.z.max(0.0) as f32), 0.5, 0.25]);
        assert!((level(&sky) - (2.0 + 0.5 + 0.25) / 3.0).abs() < 5e-3);
        assert!((level(&light(LightExposure::AUTO).applied(&sky)) - 1.0).abs() < 1e-6);
        let floor = EnvMap::from_fn(8, 4, |d| [if d.z < 0.0 { 1e30 } else { 0.0 }; 3]);
        let lit = light(LightExposure::AUTO).applied(&floor);
        assert!(
            lit.texels().iter().flatten().all(|v| v.is_finite()),
            "nothing from above is no reason for infinity"
        );
        let told = light(LightExposure::Stops(2.0)).applied(&sky);
        assert!((level(&told) / level(&sky) - 4.0).abs() < 1e-5);
    }

    #[test]
    fn the_exposure_is_a_number_or_the_word() {
        let read = |text: &str| serde_json::from_str::<KnownLight>(text).map(|l| l.exposure_ev);
        let with = |value: &str| read(&format!(r#"{{"environment": "sky", "exposure_ev": {value}}}"#));
        assert_eq!(with("-1.5").unwrap(), LightExposure::Stops(-1.5));
        assert_eq!(with(r#""auto""#).unwrap(), LightExposure::AUTO);
        assert_eq!(read(r#"{"environment": "sky"}"#).unwrap(), LightExposure::Stops(0.0));
        assert!(with(r#""bright""#).unwrap_err().to_string().contains("stops or \"auto\""));
        assert!(light(LightExposure::Stops(f64::NAN)).check().unwrap_err().contains("exposure_ev"));
        assert!(light(LightExposure::AUTO).check().is_ok());
    }
}
