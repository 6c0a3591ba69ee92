//! Views of the surface from around the model.

use glam::{Mat3, Vec3};

use crate::render::renderer::{PreparedLight, Renderer};
use crate::render::viewpoint::camera_around;
use crate::render::{Frame, Orbit, RenderError};
use relume_scene::{Camera, Model, Output};
use relume_spec::rendering::Tier;

/// Sine of the elevation of the lowest view.
const MIN_VIEW_HEIGHT: f64 = -0.17;
/// Least coverage of a pixel that shows a surface.
const MIN_COVERAGE: f32 = 0.5;
/// Depth difference of neighbouring pixels above which they belong to two surfaces and the depth there is unknown;
/// world units.
const MAX_PIXEL_DEPTH_STEP: f32 = 0.05;
/// Golden angle, degrees.
const GOLDEN_ANGLE: f64 = 137.507_764_05;

/// `count` cameras, evenly distributed around the model, in capture coordinates.
pub(super) fn around(model: &Model, count: usize, size: u32) -> Result<Vec<Camera>, RenderError> {
    let one = |i: usize| {
        let height = MIN_VIEW_HEIGHT + (1.0 - MIN_VIEW_HEIGHT) * (i as f64 + 0.5) / count as f64;
        let orbit = Orbit {
            azimuth_deg: Some(GOLDEN_ANGLE * i as f64),
            elevation_deg: Some(height.asin().to_degrees()),
            size,
        };
        Ok(camera_around(model, &orbit)?)
    };
    (0..count).map(one).collect()
}

/// A frame with its camera and depth, in the normalised world.
pub(super) struct DepthView {
    pub(super) frame: Frame,
    rotation: Mat3,
    translation: Vec3,
    centre: Vec3,
    focal: [f32; 2],
    principal: [f32; 2],
    /// Depth along the optical axis, world units: infinite without a surface, NaN if unknown.
    depth: Vec<f32>,
}

/// A point projected to a view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ViewSample {
    /// The pixel's index.
    pub(super) pixel: usize,
    /// Distance of the point along the optical axis.
    pub(super) z: f32,
    /// Distance of the surface in the pixel.
    pub(super) depth: f32,
}

impl DepthView {
    pub(super) fn new(
        renderer: &Renderer,
        light: &PreparedLight,
        camera: &Camera,
        outputs: &[Output],
    ) -> Result<Self, RenderError> {
        let frame = renderer.render(camera, light, Tier::Standard, outputs)?;
        let model = renderer.model();
        let placed = camera.in_normalised_world(model.world_scale, model.world_offset);
        let depth = depths(&frame, model.world_scale as f32);
        Ok(Self {
            frame,
            rotation: placed.rotation.as_mat3(),
            translation: placed.translation.as_vec3(),
            centre: placed.centre().as_vec3(),
            focal: [placed.fx as f32, placed.fy as f32],
            principal: [placed.cx as f32, placed.cy as f32],
            depth,
        })
    }

    /// The projection of `point`; `None` outside the image or where the depth is unknown.
    pub(super) fn find(&self, point: Vec3) -> Option<ViewSample> {
        let p = self.rotation * point + self.translation;
        if p.z <= 1e-3 {
            return None;
        }
        let (x, y) =
            (self.focal[0] * p.x / p.z + self.principal[0], self.focal[1] * p.y / p.z + self.principal[1]);
        let (width, height) = (self.frame.width as usize, self.frame.height as usize);
        if !(x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32) {
            return None;
        }
        let pixel = y as usize * width + x as usize;
        let depth = self.depth[pixel];
        (!depth.is_nan()).then_some(ViewSample { pixel, z: p.z, depth })
    }

    /// Unit direction from `point` to the camera.
    pub(super) fn towards(&self, point: Vec3) -> Vec3 {
        (self.centre - point).normalize_or_zero()
    }
}

/// Depths of a frame, as stored in [`DepthView`].
fn depths(frame: &Frame, scale: f32) -> Vec<f32> {
    let (width, height) = (frame.width as usize, frame.height as usize);
    let plane = |output| frame.planes.get(&output).map_or(&[][..], Vec::as_slice);
    let (depth, coverage) = (plane(Output::Depth), plane(Output::Alpha));
    let whole: Vec<f32> = depth
        .iter()
        .zip(coverage)
        .map(|(d, a)| if *a >= MIN_COVERAGE { d * scale } else { f32::INFINITY })
        .collect();
    let at = |x: usize, y: usize| whole[y * width + x];
    let is_edge = |x: usize, y: usize| {
        let around = [
            (x > 0).then(|| at(x - 1, y)),
            (x + 1 < width).then(|| at(x + 1, y)),
            (y > 0).then(|| at(x, y - 1)),
            (y + 1 < height).then(|| at(x, y + 1)),
        ];
        let step = |d: f32| d.is_finite() && (d - at(x, y)).abs() > MAX_PIXEL_DEPTH_STEP;
        at(x, y).is_finite() && around.into_iter().flatten().any(step)
    };
    (0..whole.len()).map(|i| if is_edge(i % width, i / width) { f32::NAN } else { whole[i] }).collect()
}
