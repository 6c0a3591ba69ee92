//! Where a model is seen from.

use glam::DVec3;

use crate::scene::{Camera, CameraError, Model};

/// Vertical field of view of an orbiting camera, degrees.
const ORBIT_FOV_DEG: f64 = 40.0;
/// Radius of what an orbiting camera frames, in the model's normalised units: the unit ball and a margin.
const ORBIT_RADIUS: f64 = 1.1;

/// A camera, or a rule that makes one for a model.
#[derive(Debug, Clone, PartialEq)]
pub enum Viewpoint {
    /// A camera in capture coordinates.
    Camera(Camera),
    /// A camera on a sphere about the model's centre.
    Orbit(Orbit),
}

/// A square view of the whole model from a direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Orbit {
    /// Degrees counter-clockwise seen from above; 0 looks along -x from the +x side.
    pub azimuth_deg: f64,
    /// Degrees above the horizon, -90 to 90.
    pub elevation_deg: f64,
    /// Side of the image, pixels.
    pub size: u32,
}

impl Viewpoint {
    /// The camera for `model`.
    ///
    /// # Errors
    /// Names the field that does not make a camera.
    pub fn camera(&self, model: &Model) -> Result<Camera, CameraError> {
        match self {
            Self::Camera(camera) => Ok(*camera),
            Self::Orbit(orbit) => orbit.camera(model),
        }
    }
}

impl Orbit {
    fn camera(&self, model: &Model) -> Result<Camera, CameraError> {
        let fov = ORBIT_FOV_DEG.to_radians();
        let distance = ORBIT_RADIUS / (0.5 * fov).sin() / model.world_scale;
        let (sin_a, cos_a) = self.azimuth_deg.to_radians().sin_cos();
        let (sin_e, cos_e) = self.elevation_deg.to_radians().sin_cos();
        let centre = -model.world_offset;
        let camera_centre = centre + DVec3::new(cos_a * cos_e, sin_a * cos_e, sin_e) * distance;
        Camera::look_at(camera_centre, centre, DVec3::Z, fov, (self.size, self.size))
    }
}
