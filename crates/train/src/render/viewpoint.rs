//! Viewpoints of a model.

use glam::DVec3;

use relume_scene::{Camera, CameraError, Framing, Model, PhotographedViews, direction_of};

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

/// A square view of the subject of a model. The default direction, the distance and the field of view are those of the photographs if
/// the model records them ([`PhotographedViews`]), else those of its framing (captures without masks), else the whole unit ball.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Orbit {
    /// Degrees counter-clockwise seen from above, from the first photograph if the model records it; otherwise at 0 the camera is
    /// on the +x side and looks along -x. `None`: 0, or that of the model's framing.
    pub azimuth_deg: Option<f64>,
    /// Degrees above the horizon, -90 to 90. `None`: the median of the photographs, that of the model's framing, or 20.
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
    /// The specified azimuth, else the default for `model`, degrees, counted as [`Self::azimuth_deg`].
    pub fn azimuth_of(&self, model: &Model) -> f64 {
        self.azimuth_deg.unwrap_or_else(|| DefaultView::of(model).azimuth_deg)
    }

    fn camera(&self, model: &Model) -> Result<Camera, CameraError> {
        DefaultView::of(model).camera(self)
    }
}

/// The view of a model without a requested direction.
#[derive(Debug, Clone, Copy)]
struct DefaultView {
    target: DVec3,
    distance: f64,
    /// Counted from `zero_deg`.
    azimuth_deg: f64,
    /// Above the horizon.
    elevation_deg: f64,
    fov_deg: f64,
    /// The azimuth from which azimuths are counted, degrees from +x.
    zero_deg: f64,
}

impl DefaultView {
    fn of(model: &Model) -> Self {
        match PhotographedViews::of_card(&model.card) {
            Some(views) => Self::of_photographs(&views),
            None => Self::without_photographs(model),
        }
    }

    fn of_photographs(views: &PhotographedViews) -> Self {
        let (distance, fov_deg) = views.distance_and_fov();
        Self {
            target: views.target,
            distance,
            azimuth_deg: 0.0,
            elevation_deg: views.elevation_deg,
            fov_deg,
            zero_deg: views.azimuth_deg,
        }
    }

    fn without_photographs(model: &Model) -> Self {
        let Framing { eye, target, fov_deg } = model.framing.unwrap_or_else(|| around(model));
        let away = eye - target;
        Self {
            target,
            distance: away.length(),
            azimuth_deg: away.y.atan2(away.x).to_degrees(),
            elevation_deg: away.z.atan2(away.truncate().length()).to_degrees(),
            fov_deg,
            zero_deg: 0.0,
        }
    }

    fn camera(&self, orbit: &Orbit) -> Result<Camera, CameraError> {
        let azimuth_deg = self.zero_deg + orbit.azimuth_deg.unwrap_or(self.azimuth_deg);
        let elevation_deg = orbit.elevation_deg.unwrap_or(self.elevation_deg);
        let eye = self.target + self.distance * direction_of(azimuth_deg, elevation_deg);
        Camera::look_at(eye, self.target, DVec3::Z, self.fov_deg.to_radians(), (orbit.size, orbit.size))
    }
}

/// The camera of `orbit` around the whole model. The record of the photographed directions has no effect.
///
/// # Errors
/// Names the field that gives no valid camera.
pub(super) fn camera_around(model: &Model, orbit: &Orbit) -> Result<Camera, CameraError> {
    DefaultView::without_photographs(model).camera(orbit)
}

/// The default view of `model`.
pub(super) fn framing(model: &Model) -> Framing {
    match PhotographedViews::of_card(&model.card) {
        Some(views) => views.framing(),
        None => model.framing.unwrap_or_else(|| around(model)),
    }
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
    use relume_scene::{Gaussians, PhotographedDirection, ShadingOptions};
    use serde_json::json;

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

    /// Photographs around (-1, 0, 0) at an elevation of 35 degrees, the first at an azimuth of 110 degrees.
    fn photographed() -> Model {
        let photograph = |i: u32| PhotographedDirection {
            name: format!("{i}.jpg"),
            azimuth_deg: 110.0 + 20.0 * f64::from(i),
            elevation_deg: 35.0,
        };
        let views = PhotographedViews {
            target: DVec3::new(-1.0, 0.0, 0.0),
            radius: 0.4,
            distance: 2.5,
            azimuth_deg: 110.0,
            elevation_deg: 35.0,
            fov_deg: 50.0,
            photographs: (0..5).map(photograph).collect(),
        };
        Model { card: json!({ "photographed_views": views }), ..model(None) }
    }

    #[test]
    fn default_viewpoint_is_that_of_the_first_photograph() {
        let (model, target) = (photographed(), DVec3::new(-1.0, 0.0, 0.0));
        let seen = camera(&model, None, None);
        assert!((seen.centre() - (target + 2.5 * direction_of(110.0, 35.0))).length() < 1e-12);
        assert_eq!(seen, camera(&model, Some(0.0), None), "azimuth 0 is the first photograph");
        // The subject and its margin fill the picture.
        assert!((8.0 / seen.fy - (0.44f64 / 2.5).asin().tan()).abs() < 1e-12);
        let turned = camera(&model, Some(30.0), Some(10.0));
        assert!((turned.centre() - (target + 2.5 * direction_of(140.0, 10.0))).length() < 1e-12);
        let framing = Framing { eye: DVec3::new(0.0, -3.0, 1.0), target: DVec3::Z, fov_deg: 50.0 };
        let both = Model { framing: Some(framing), ..photographed() };
        assert_eq!(camera(&both, None, None), seen, "the photographs precede the framing");
    }

    #[test]
    fn models_without_photographed_views_keep_their_defaults() {
        let framing = Framing { eye: DVec3::new(0.0, -3.0, 1.0), target: DVec3::Z, fov_deg: 50.0 };
        for old in [model(None), model(Some(framing))] {
            let damaged = json!({ "photographed_views": { "radius": -1.0 } });
            for card in [json!({}), json!({ "photographed_views": null }), damaged] {
                let other = Model { card, ..old.clone() };
                assert_eq!(camera(&other, None, None), camera(&old, None, None));
                assert_eq!(camera(&other, Some(30.0), None), camera(&old, Some(30.0), None));
            }
            let new = Model { card: photographed().card, ..old.clone() };
            assert_ne!(camera(&new, None, None), camera(&old, None, None), "the control");
            let orbit = Orbit { azimuth_deg: Some(30.0), elevation_deg: None, size: 16 };
            assert_eq!(camera_around(&new, &orbit), camera_around(&old, &orbit), "views for meshes");
        }
    }

    #[test]
    fn viewers_start_at_the_default_viewpoint() {
        for model in [model(None), photographed()] {
            let (seen, framing) = (camera(&model, None, None), framing(&model));
            assert!((seen.centre() - framing.eye).length() < 1e-12);
            assert!((8.0 / seen.fy - (0.5 * framing.fov_deg.to_radians()).tan()).abs() < 1e-12);
        }
    }
}
