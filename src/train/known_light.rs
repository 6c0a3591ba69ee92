//! The light that the photographs were taken in, where somebody measured it.

use serde::{Deserialize, Serialize};

/// Most characters of an environment's name.
const LONGEST_NAME: usize = 1024;
/// Largest exposure either way, stops.
const MOST_STOPS: f64 = 20.0;

/// A measured light: training holds it, instead of recovering one beside the materials.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KnownLight {
    /// A built-in map, an uploaded environment's identifier, or on the command line a file.
    pub environment: String,
    /// Turn of the map about the capture's +Z, degrees counter-clockwise seen from above.
    #[serde(default)]
    pub rotation_deg: f64,
    /// Exposure of the map, -20 to 20 stops: at 0, a surface that sends a radiance of 1 is white in the photographs.
    #[serde(default)]
    pub exposure_ev: f64,
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
        if !(-MOST_STOPS..=MOST_STOPS).contains(&self.exposure_ev) {
            return Err(format!("light.exposure_ev: must be -{MOST_STOPS} to {MOST_STOPS}"));
        }
        Ok(())
    }
}
