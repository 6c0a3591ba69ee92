//! Places for further photographs.

use crate::render::orbit_camera;
use relume_scene::{Camera, CameraError, Model, PhotographedViews};

/// Azimuths of the places, on each of these elevations above the horizon, degrees. Places below the horizon are proposed only between
/// photographs from below it.
const AZIMUTHS: u32 = 24;
const ELEVATIONS_DEG: [f64; 6] = [-15.0, 0.0, 15.0, 30.0, 50.0, 70.0];
/// Width and height of their cameras, pixels.
const SIDE: u32 = 512;

/// Cameras around the subject of a model, at the distance of its photographs, capture units. Empty without a subject.
///
/// # Errors
/// If the recorded subject gives no valid camera.
pub fn places_around(model: &Model) -> Result<Vec<Camera>, CameraError> {
    let Some(photographed) = PhotographedViews::of_card(&model.card) else { return Ok(Vec::new()) };
    let lowest = photographed.photographs.iter().map(|p| p.elevation_deg).fold(0.0, f64::min);
    let mut cameras = Vec::new();
    for elevation in ELEVATIONS_DEG.into_iter().filter(|elevation| *elevation >= lowest) {
        for azimuth in (0..AZIMUTHS).map(|i| 360.0 * f64::from(i) / f64::from(AZIMUTHS)) {
            cameras.push(orbit_camera(model, Some(azimuth), Some(elevation), (SIDE, SIDE))?);
        }
    }
    Ok(cameras)
}
