//! Estimates the position and size of the object from the cameras and the sparse points.

use glam::{DMat3, DVec3};

use crate::symmetric::outer;
use crate::{CaptureView, SceneBounds, rig};
use relume_scene::{Camera, FRAME_MARGIN, Framing};

/// Radius of the object relative to the ball that a camera sees completely.
const CORNER_MARGIN: f64 = 1.15;
/// Size of a room relative to the distance of the cameras from their middle, for cameras that look outwards. People turn round on
/// the spot with an arm's length of movement; a room is several metres wide.
const ROOM: f64 = 10.0;
/// Least [`Axes::spread`] of optical axes that determine a point: their directions differ by about 2 degrees (standard deviation).
const MIN_CONVERGENCE: f64 = 1e-3;

/// The region of interest.
///
/// - With points: the centre is their median. The radius is the distance within which 90 % of them lie, at most twice
///   that of the farthest camera, so that a few very distant points have no effect.
/// - Without points, with masks: the centre is the point nearest to all optical axes. The radius is that of the ball
///   that the median camera just sees completely, times [`CORNER_MARGIN`], since tightly framed objects reach into
///   the image's corners. For NeRF-synthetic this gives the origin and radius 1.57.
/// - Without points and masks: the same centre. The radius is the distance of the median camera, since the
///   photographs also show the surroundings; [`ROOM`] times that if most cameras look outwards.
pub(super) fn bounds(views: &[CaptureView], points: &[(DVec3, [f32; 3])], has_alpha: bool) -> SceneBounds {
    let cameras: Vec<&Camera> = views.iter().map(|v| &v.camera).collect();
    if points.len() >= 16 {
        return from_points(&cameras, points);
    }
    let centre = looked_at(&cameras);
    let radius = |camera: &&Camera| {
        let distance = (camera.centre() - centre).length();
        if has_alpha { seen_radius(camera, centre).map_or(distance, |r| r * CORNER_MARGIN) } else { distance }
    };
    let looks_inwards = |camera: &&&Camera| camera.forward().dot(centre - camera.centre()) > 0.0;
    let is_room = !has_alpha && 2 * cameras.iter().filter(looks_inwards).count() < cameras.len();
    let scale = if is_room { ROOM } else { 1.0 };
    let radius = scale * quantile(cameras.iter().map(radius).collect(), 0.5);
    SceneBounds { centre, radius: positive(radius) }
}

/// The region that the cameras look at: the point nearest to all optical axes, and the radius of the ball around it
/// that fills the longer side of the median camera's image. An object is rarely in the middle of every image, and
/// rarely smaller than this ball.
pub fn focus_region(cameras: &[&Camera]) -> (DVec3, f64) {
    let centre = looked_at(cameras);
    let radius = |camera: &&Camera| {
        let half_angle = f64::max(
            (0.5 * f64::from(camera.width) / camera.fx).atan(),
            (0.5 * f64::from(camera.height) / camera.fy).atan(),
        );
        (camera.centre() - centre).length() * half_angle.sin()
    };
    (centre, positive(quantile(cameras.iter().map(radius).collect(), 0.5)))
}

/// Centre and radius of the ball that the photographs show completely. The centre is the point that the cameras look at. The radius is
/// the median over the cameras, each taken as a square picture of the same area, less the margin [`FRAME_MARGIN`]. `None` if the optical
/// axes are too parallel to determine a point.
pub fn shown_ball(cameras: &[&Camera]) -> Option<(DVec3, f64)> {
    let axes = axes_of(cameras);
    // Also true without axes.
    if !(axes.spread() >= MIN_CONVERGENCE) {
        return None;
    }
    let centre = axes.nearest_point();
    let radius = |camera: &&Camera| (camera.centre() - centre).length() * square_half_angle(camera).sin();
    let radius = quantile(cameras.iter().map(radius).collect(), 0.5) / FRAME_MARGIN;
    (centre.is_finite() && radius > 0.0).then_some((centre, radius))
}

/// Half the field of view of the shorter side of a camera's image, radians.
fn half_angle(camera: &Camera) -> f64 {
    f64::min(
        (0.5 * f64::from(camera.width) / camera.fx).atan(),
        (0.5 * f64::from(camera.height) / camera.fy).atan(),
    )
}

/// Half the field of view of a square picture with the area of a camera's image, radians. A subject that a photograph of any aspect
/// shows away from its middle remains in such a picture.
pub(super) fn square_half_angle(camera: &Camera) -> f64 {
    let area = f64::from(camera.width) / camera.fx * f64::from(camera.height) / camera.fy;
    (0.5 * area.sqrt()).atan()
}

/// The default view of a model: the camera in the middle of all directions, pointed at the point nearest to all
/// optical axes. The field of view is that of the camera's shorter side. `None` without cameras, or if the camera
/// lies at that point.
pub fn framing(cameras: &[&Camera]) -> Option<Framing> {
    let target = looked_at(cameras);
    let direction = |camera: &Camera| (camera.centre() - target).normalize_or_zero();
    let middle = cameras.iter().map(|camera| direction(camera)).sum::<DVec3>();
    let nearness = |camera: &Camera| direction(camera).dot(middle);
    let camera = cameras.iter().max_by(|a, b| nearness(a).total_cmp(&nearness(b)))?;
    Framing { eye: camera.centre(), target, fov_deg: 2.0 * half_angle(camera).to_degrees() }.checked()
}

fn from_points(cameras: &[&Camera], points: &[(DVec3, [f32; 3])]) -> SceneBounds {
    let median = |axis: usize| quantile(points.iter().map(|(p, _)| p[axis]).collect(), 0.5);
    let centre = DVec3::new(median(0), median(1), median(2));
    let reach = quantile(points.iter().map(|(p, _)| (*p - centre).length()).collect(), 0.9);
    let farthest = cameras.iter().map(|c| (c.centre() - centre).length()).fold(0.0, f64::max);
    SceneBounds { centre, radius: positive(reach.min(2.0 * farthest)) }
}

fn positive(radius: f64) -> f64 {
    if radius.is_finite() && radius > 0.0 { radius } else { 1.0 }
}

/// The `q`-quantile of `values`, nearest rank; 0 when there are none.
pub(super) fn quantile(mut values: Vec<f64>, q: f64) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let index = ((values.len() - 1) as f64 * q).round() as usize;
    *values.select_nth_unstable_by(index, f64::total_cmp).1
}

/// Sums over optical axes, each an origin and a unit direction.
#[derive(Default)]
pub(super) struct Axes {
    /// Sum of the projections across the axes.
    normal: DMat3,
    /// Sum of the projected origins.
    moment: DVec3,
    /// Sum of the points one unit in front of the cameras.
    ahead: DVec3,
    count: f64,
}

impl Axes {
    pub(super) fn of(axes: impl Iterator<Item = (DVec3, DVec3)>) -> Self {
        let mut sums = Self { normal: DMat3::ZERO, ..Self::default() };
        for (eye, d) in axes {
            let across = DMat3::IDENTITY - outer(d);
            sums.normal += across;
            sums.moment += across * eye;
            sums.ahead += eye + d;
            sums.count += 1.0;
        }
        sums
    }

    /// Determinant of the mean of `1 - d d^T` over the directions `d`: about the mean squared sine of their angles to the mean
    /// direction. NaN without axes.
    pub(super) fn spread(&self) -> f64 {
        self.normal.determinant() / self.count.powi(3)
    }

    /// See [`nearest_to_axes`].
    pub(super) fn nearest_point(&self) -> DVec3 {
        if self.spread() > 1e-6 {
            return self.normal.inverse() * self.moment;
        }
        self.ahead / self.count.max(1.0)
    }
}

/// The point with the least summed squared distance to the axes, each an origin and a unit direction. When the axes are nearly parallel, so
/// that this point is not well defined: the mean of the points one unit in front of the cameras.
pub(super) fn nearest_to_axes(axes: impl Iterator<Item = (DVec3, DVec3)>) -> DVec3 {
    Axes::of(axes).nearest_point()
}

/// The point that the cameras look at, without stray cameras.
fn looked_at(cameras: &[&Camera]) -> DVec3 {
    axes_of(cameras).nearest_point()
}

/// The optical axes of the cameras, without stray cameras.
fn axes_of(cameras: &[&Camera]) -> Axes {
    let strays = rig::strays(&cameras.iter().map(|c| c.centre()).collect::<Vec<_>>());
    let usual = cameras.iter().enumerate().filter(|(i, _)| !strays.contains(i));
    Axes::of(usual.map(|(_, camera)| (camera.centre(), camera.forward())))
}

/// Radius of the largest ball around `centre` inside the camera's frustum; `None` when the centre is outside.
fn seen_radius(camera: &Camera, centre: DVec3) -> Option<f64> {
    let p = camera.rotation * centre + camera.translation;
    let (w, h) = (f64::from(camera.width), f64::from(camera.height));
    // Each side plane contains the camera's centre and one image edge, which gives its inward normal.
    let sides = [
        DVec3::new(camera.fx, 0.0, camera.cx),
        DVec3::new(-camera.fx, 0.0, w - camera.cx),
        DVec3::new(0.0, camera.fy, camera.cy),
        DVec3::new(0.0, -camera.fy, h - camera.cy),
    ];
    let radius = sides.iter().map(|n| n.normalize().dot(p)).fold(f64::INFINITY, f64::min);
    (radius > 0.0).then_some(radius)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::GroundTruthView;
    use relume_scene::{BitDepth, ImageRgba, PackedImage};

    fn ring(centre: DVec3, distance: f64) -> Vec<CaptureView> {
        let nothing = ImageRgba { width: 1, height: 1, pixels: vec![[0.0; 4]] };
        let view = |i: usize| {
            let angle = i as f64 * 0.7;
            let eye = centre + distance * DVec3::new(angle.cos(), angle.sin(), 0.5).normalize();
            CaptureView {
                name: format!("{i}"),
                camera: Camera::look_at(eye, centre, DVec3::Z, 0.691_111_2, (80, 80)).unwrap(),
                image: PackedImage::new(&nothing, BitDepth::Eight),
                light_rotation_deg: 0.0,
                light_group: None,
                truth: GroundTruthView::default(),
            }
        };
        (0..9).map(view).collect()
    }

    #[test]
    fn bounds_of_masked_object_are_the_sphere_all_cameras_see() {
        let centre = DVec3::new(1.0, -2.0, 0.5);
        let b = bounds(&ring(centre, 4.031), &[], true);
        assert!((b.centre - centre).length() < 1e-9);
        let whole = 4.031 * (0.5f64 * 0.691_111_2).sin();
        assert!((b.radius - CORNER_MARGIN * whole).abs() < 1e-9, "{}", b.radius);
        assert!((bounds(&ring(centre, 4.031), &[], false).radius - 4.031).abs() < 1e-9);
    }

    #[test]
    fn cameras_that_look_outwards_are_in_a_room() {
        let inwards = ring(DVec3::ZERO, 0.2);
        assert!((bounds(&inwards, &[], false).radius - 0.2).abs() < 1e-9, "the control");
        let mut outwards = inwards;
        for camera in outwards.iter_mut().map(|view| &mut view.camera) {
            let eye = camera.centre();
            // Half a turn about the camera's own vertical axis.
            camera.rotation = DMat3::from_diagonal(DVec3::new(-1.0, 1.0, -1.0)) * camera.rotation;
            camera.translation = -(camera.rotation * eye);
        }
        assert!((bounds(&outwards, &[], false).radius - 2.0).abs() < 1e-9);
    }

    #[test]
    fn stray_points_do_not_move_the_bounds() {
        let mut points: Vec<_> = (0..100).map(|i| (DVec3::splat(i as f64 * 1e-2), [0.0; 3])).collect();
        let before = bounds(&ring(DVec3::ZERO, 3.0), &points, false);
        points.extend([(DVec3::splat(1e6), [0.0; 3]); 3]);
        let after = bounds(&ring(DVec3::ZERO, 3.0), &points, false);
        assert!(
            (before.centre - after.centre).length() < 0.05 && (before.radius - after.radius).abs() < 0.05
        );
        points.extend([(DVec3::splat(1e6), [0.0; 3]); 60]);
        assert!(bounds(&ring(DVec3::ZERO, 3.0), &points, false).radius <= 6.0 + 2.0);
    }

    #[test]
    fn framing_uses_the_camera_in_the_middle_of_the_photographs() {
        let centre = DVec3::new(1.0, -2.0, 0.5);
        let views = ring(centre, 3.0);
        // Five photographs of a fan; the third is in its middle.
        let fan: Vec<&Camera> = views[..5].iter().map(|view| &view.camera).collect();
        let framing = framing(&fan).unwrap();
        assert!((framing.eye - fan[2].centre()).length() < 1e-9);
        assert!((framing.target - centre).length() < 1e-9);
        assert!((framing.fov_deg - 0.691_111_2f64.to_degrees()).abs() < 1e-9);
        assert_eq!(super::framing(&[]), None);
    }

    #[test]
    fn parallel_axes_still_give_finite_bounds() {
        let view = &ring(DVec3::ZERO, 3.0)[0];
        let b = bounds(&[view.clone(), view.clone()], &[], true);
        assert!(b.centre.is_finite() && b.radius > 0.0);
    }
}
