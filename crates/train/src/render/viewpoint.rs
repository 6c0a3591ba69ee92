//! Viewpoints of a model.

use glam::DVec3;

use relume_scene::{Camera, CameraError, Framing, Model};

/// Vertical field of view of an orbiting camera, degrees.
const ORBIT_FOV_DEG: f64 = 40.0;
/// Default elevation of an orbiting camera, degrees.
const ORBIT_ELEVATION_DEG: f64 = 20.0;
/// Radius of the ball that an orbiting camera frames, in the model's normalised units: the unit ball and a margin.
const ORBIT_RADIUS: f64 = 1.1;

/// A camera, or a rule that gives one for a model.
#[derive(Debug, Clone, PartialEq)]
pub enum Viewpoint {
    /// A camera in capture coordinates.
    Camera(Camera),
    /// A camera on a sphere about the model's centre.
    Orbit(Orbit),
}

/// A square view of the whole model from a direction. For a capture without masks, the default direction and distance
/// are those of the photographs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Orbit {
    /// Degrees counter-clockwise seen from above; at 0 the camera is on the +x side and looks along -x. `None`: 0, or
    /// that of the model's framing.
    pub azimuth_deg: Option<f64>,
    /// Degrees above the horizon, -90 to 90. `None`: 20, or that of the model's framing.
    pub elevation_deg: Option<f64>,
    /// Side of the image, pixels.
    pub size: u32,
}

impl Viewpoint {
    /// The camera for `model`.
    ///
    /// # Errors
    /// Names the field that gives no valid camera.
    pub fn camera(&self, model: &Model) -> Result<Camera, CameraError> {
        match self {
            Self::Camera(camera) => Ok(*camera),
            Self::Orbit(orbit) => orbit.camera(model),
        }
    }
}

impl Orbit {
    /// The specified azimuth, else the default for `model`, degrees.
    pub fn azimuth_of(&self, model: &Model) -> f64 {
        let framing = model.framing.unwrap_or_else(|| around(model));
        let away = framing.eye - framing.target;
        self.azimuth_deg.unwrap_or_else(|| away.y.atan2(away.x).to_degrees())
    }

    fn camera(&self, model: &Model) -> Result<Camera, CameraError> {
        let framing = framing(model);
        let away = framing.eye - framing.target;
        let azimuth = self.azimuth_of(model).to_radians();
        let elevation = self.elevation_deg.map_or(away.z.atan2(away.truncate().length()), f64::to_radians);
        let (sin_a, cos_a) = azimuth.sin_cos();
        let (sin_e, cos_e) = elevation.sin_cos();
        let eye = framing.target + DVec3::new(cos_a * cos_e, sin_a * cos_e, sin_e) * away.length();
        Camera::look_at(eye, framing.target, DVec3::Z, framing.fov_deg.to_radians(), (self.size, self.size))
    }
}

/// The default view of `model`.
pub(super) fn framing(model: &Model) -> Framing {
    model.framing.unwrap_or_else(|| around(model))
}

/// A view of the complete unit ball.
fn around(model: &Model) -> Framing {
    let distance = ORBIT_RADIUS / (0.5 * ORBIT_FOV_DEG.to_radians()).sin() / model.world_scale;
    let target = -model.world_offset;
    let (sin, cos) = ORBIT_ELEVATION_DEG.to_radians().sin_cos();
    Framing { eye: target + DVec3::new(cos, 0.0, sin) * distance, target, fov_deg: ORBIT_FOV_DEG }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_scene::{Gaussians, ShadingOptions};

    fn model(framing: Option<Framing>) -> Model {
        Model {
            gaussians: Gaussians::zeroed(1, 1, 0, 0),
            prototypes: vec![[0.5; 3]],
            env_raw: vec![[0.0; 3]; 2],
            env_width: 2,
            env_height: 1,
            lights: Default::default(),
            shading: ShadingOptions::default(),
            world_scale: 2.0,
            world_offset: DVec3::new(1.0, 0.0, 0.0),
            framing,
            card: serde_json::Value::Null,
        }
    }

    fn camera(model: &Model, azimuth_deg: Option<f64>, elevation_deg: Option<f64>) -> Camera {
        Viewpoint::Orbit(Orbit { azimuth_deg, elevation_deg, size: 16 }).camera(model).unwrap()
    }

    #[test]
    fn default_viewpoint_shows_a_masked_object_completely() {
        let (model, centre) = (model(None), DVec3::new(-1.0, 0.0, 0.0));
        let seen = camera(&model, None, None);
        let stated = camera(&model, Some(0.0), Some(20.0));
        assert!((seen.centre() - stated.centre()).length() < 1e-12, "the defaults");
        let away = seen.centre() - centre;
        assert!((away.length() * (20.0f64).to_radians().sin() - 0.55).abs() < 1e-12, "1.1 of 0.5");
        assert!((away.z / away.length() - (20.0f64).to_radians().sin()).abs() < 1e-12);
    }

    #[test]
    fn default_viewpoint_of_unmasked_scene_uses_its_framing() {
        let framing = Framing { eye: DVec3::new(0.0, -3.0, 1.0), target: DVec3::Z, fov_deg: 50.0 };
        let model = model(Some(framing));
        let seen = camera(&model, None, None);
        assert!((seen.centre() - framing.eye).length() < 1e-12);
        assert!((seen.forward() - DVec3::Y).length() < 1e-12);
        assert!((8.0 / seen.fy - (25.0f64).to_radians().tan()).abs() < 1e-12);
        let turned = camera(&model, Some(90.0), None);
        assert!((turned.centre() - DVec3::new(0.0, 3.0, 1.0)).length() < 1e-12, "{:?}", turned.centre());
        let above = camera(&model, None, Some(90.0));
        assert!((above.centre() - DVec3::new(0.0, 0.0, 4.0)).length() < 1e-12, "{:?}", above.centre());
    }
}
