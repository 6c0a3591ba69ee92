//! Frame sequences: a camera and a rotation of the light for each frame.

use crate::render::motion::Neighbours;
use crate::render::viewpoint::{Orbit, Viewpoint};
use relume_scene::{Camera, CameraError, Model};

/// Camera and light rotation of a frame in a sequence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameView {
    /// The camera, capture units.
    pub camera: Camera,
    /// Rotation of the light about +Z in addition to the rotation common to all frames, degrees counter-clockwise.
    pub light_rotation_deg: f64,
    /// The cameras before and after this one. None exist before [`linked`].
    pub neighbours: Neighbours,
}

impl FrameView {
    /// A view without neighbours.
    pub fn new(camera: Camera, light_rotation_deg: f64) -> Self {
        Self { camera, light_rotation_deg, neighbours: Neighbours::default() }
    }
}

/// The views of a sequence, each with its neighbours.
pub fn linked(mut views: Vec<FrameView>) -> Vec<FrameView> {
    let cameras: Vec<Camera> = views.iter().map(|view| view.camera).collect();
    for (i, view) in views.iter_mut().enumerate() {
        let previous = i.checked_sub(1).map(|before| cameras[before]);
        view.neighbours = Neighbours { previous, next: cameras.get(i + 1).copied() };
    }
    views
}

/// Cameras on a circle around a model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turntable {
    /// Number of frames.
    pub frames: u32,
    /// Azimuth of the first camera, as in [`Orbit::azimuth_deg`].
    pub azimuth_deg: Option<f64>,
    /// Elevation of the cameras, as in [`Orbit::elevation_deg`].
    pub elevation_deg: Option<f64>,
    /// Rotation of the camera from the first frame to the one after the last, degrees counter-clockwise.
    pub camera_turn_deg: f64,
    /// Width and height, pixels.
    pub size: (u32, u32),
}

impl Turntable {
    /// The views of `model`, in order, without rotation of the light.
    ///
    /// # Errors
    /// Names the field that gives no valid camera.
    pub fn views(&self, model: &Model) -> Result<Vec<FrameView>, CameraError> {
        let side = self.size.0.min(self.size.1);
        let start = Orbit { azimuth_deg: self.azimuth_deg, elevation_deg: self.elevation_deg, size: side };
        let start = start.azimuth_of(model);
        let azimuth = |i: u32| start + self.camera_turn_deg * f64::from(i) / f64::from(self.frames);
        let view = |i| {
            let camera = orbit_camera(model, Some(azimuth(i)), self.elevation_deg, self.size)?;
            Ok(FrameView::new(camera, 0.0))
        };
        (0..self.frames).map(view).collect()
    }
}

/// A camera around a model, as specified by [`Orbit`]. An image that is not square shows more along its longer side.
///
/// # Errors
/// Names the field that gives no valid camera.
pub fn orbit_camera(
    model: &Model,
    azimuth_deg: Option<f64>,
    elevation_deg: Option<f64>,
    (width, height): (u32, u32),
) -> Result<Camera, CameraError> {
    let orbit = Orbit { azimuth_deg, elevation_deg, size: width.min(height) };
    let camera = Viewpoint::Orbit(orbit).camera(model)?;
    Ok(Camera { width, height, cx: 0.5 * f64::from(width), cy: 0.5 * f64::from(height), ..camera })
}

/// Rotates the light by `turn_deg` from the first view to the one after the last, in addition to the rotation of each
/// view.
pub fn rotate_light(views: &mut [FrameView], turn_deg: f64) {
    let frames = views.len() as f64;
    for (i, view) in views.iter_mut().enumerate() {
        view.light_rotation_deg += turn_deg * i as f64 / frames;
    }
}

/// Resizes the views.
///
/// # Errors
/// The index of the first view whose aspect ratio would change by more than 1 %, and the reason.
pub fn resized(
    views: Vec<FrameView>,
    (width, height): (u32, u32),
) -> Result<Vec<FrameView>, (usize, String)> {
    let resized = |(i, view): (usize, FrameView)| {
        let Camera { width: w, height: h, .. } = view.camera;
        let aspects = [(w, h), (width, height)].map(|(w, h)| f64::from(w) / f64::from(h));
        if (aspects[0] / aspects[1] - 1.0).abs() > 0.01 {
            return Err((i, format!("has {w}x{h} pixels, another aspect ratio than {width}x{height}")));
        }
        Ok(FrameView { camera: view.camera.resized(width, height), ..view })
    };
    views.into_iter().enumerate().map(resized).collect()
}
