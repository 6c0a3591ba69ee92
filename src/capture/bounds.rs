//! Where the subject is, told from the cameras and the sparse points.

use glam::{DMat3, DVec3};

use crate::capture::{CaptureView, Scene3dBounds};
use crate::scene::Camera;

/// Share of the ball seen whole that a subject may reach.
const CORNER_MARGIN: f64 = 1.15;

/// The region of interest.
///
/// - With points: centred on their median, as large as the distance 90 % of them keep, but never beyond twice
///   the farthest camera (a few points on the horizon must not decide).
/// - Without, for a cut-out subject: the ball around the point nearest to all optical axes that the median
///   camera just sees whole, and 15 % more, since tightly framed subjects reach into the image's corners. For
///   NeRF-synthetic that is the origin with radius 1.57.
/// - Without, for whole photographs: the same centre, reaching out to the median camera, since the surroundings
///   are in the picture too.
pub(super) fn bounds(views: &[CaptureView], points: &[(DVec3, [f32; 3])], has_alpha: bool) -> Scene3dBounds {
    let cameras: Vec<&Camera> = views.iter().map(|v| &v.camera).collect();
    if points.len() >= 16 {
        return from_points(&cameras, points);
    }
    let centre = nearest_to_axes(&cameras);
    let radius = |camera: &&Camera| {
        let distance = (camera.centre() - centre).length();
        if has_alpha { seen_radius(camera, centre).map_or(distance, |r| r * CORNER_MARGIN) } else { distance }
    };
    let radius = quantile(cameras.iter().map(radius).collect(), 0.5);
    Scene3dBounds { centre, radius: positive(radius) }
}

fn from_points(cameras: &[&Camera], points: &[(DVec3, [f32; 3])]) -> Scene3dBounds {
    let median = |axis: usize| quantile(points.iter().map(|(p, _)| p[axis]).collect(), 0.5);
    let centre = DVec3::new(median(0), median(1), median(2));
    let reach = quantile(points.iter().map(|(p, _)| (*p - centre).length()).collect(), 0.9);
    let farthest = cameras.iter().map(|c| (c.centre() - centre).length()).fold(0.0, f64::max);
    Scene3dBounds { centre, radius: positive(reach.min(2.0 * farthest)) }
}

fn positive(radius: f64) -> f64 {
    if radius.is_finite() && radius > 0.0 { radius } else { 1.0 }
}

/// The value below which a share `q` of `values` lies; 0 of nothing.
fn quantile(mut values: Vec<f64>, q: f64) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let index = ((values.len() - 1) as f64 * q).round() as usize;
    *values.select_nth_unstable_by(index, f64::total_cmp).1
}

/// The point with the least summed squared distance to the optical axes, or, when the axes are parallel and
/// no such point stands out, the cameras' mean one unit ahead.
fn nearest_to_axes(cameras: &[&Camera]) -> DVec3 {
    let mut normal = DMat3::ZERO;
    let mut moment = DVec3::ZERO;
    for camera in cameras {
        let d = camera.forward();
        let across = DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        normal += across;
        moment += across * camera.centre();
    }
    let count = cameras.len().max(1) as f64;
    if normal.determinant() > 1e-6 * count.powi(3) {
        return normal.inverse() * moment;
    }
    let ahead = |c: &&Camera| c.centre() + c.forward();
    cameras.iter().map(ahead).sum::<DVec3>() / count
}

/// Radius of the largest ball around `centre` that lies inside the camera's frustum; nothing when the centre
/// itself is outside.
fn seen_radius(camera: &Camera, centre: DVec3) -> Option<f64> {
    let p = camera.rotation * centre + camera.translation;
    let (w, h) = (f64::from(camera.width), f64::from(camera.height));
    // Each side plane holds the camera's centre and one image edge; its inward normal follows from that edge.
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
    use crate::capture::{GroundTruthView, ImageRgba};

    fn ring(centre: DVec3, distance: f64) -> Vec<CaptureView> {
        let view = |i: usize| {
            let angle = i as f64 * 0.7;
            let eye = centre + distance * DVec3::new(angle.cos(), angle.sin(), 0.5).normalize();
            CaptureView {
                name: format!("{i}"),
                camera: Camera::look_at(eye, centre, DVec3::Z, 0.691_111_2, (80, 80)).unwrap(),
                image: ImageRgba { width: 1, height: 1, pixels: vec![[0.0; 4]] },
                truth: GroundTruthView::default(),
            }
        };
        (0..9).map(view).collect()
    }

    #[test]
    fn a_cut_out_subject_lies_in_the_ball_that_all_cameras_see() {
        let centre = DVec3::new(1.0, -2.0, 0.5);
        let b = bounds(&ring(centre, 4.031), &[], true);
        assert!((b.centre - centre).length() < 1e-9);
        let whole = 4.031 * (0.5f64 * 0.691_111_2).sin();
        assert!((b.radius - CORNER_MARGIN * whole).abs() < 1e-9, "{}", b.radius);
        assert!((bounds(&ring(centre, 4.031), &[], false).radius - 4.031).abs() < 1e-9);
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
    fn parallel_axes_still_give_finite_bounds() {
        let view = &ring(DVec3::ZERO, 3.0)[0];
        let b = bounds(&[view.clone(), view.clone()], &[], true);
        assert!(b.centre.is_finite() && b.radius > 0.0);
    }
}
