//! What the cameras of a capture say about the up direction.

use glam::{DMat3, DMat4, DVec3};

use crate::symmetric::{eigen, outer};

/// Least length of the mean up direction of cameras that agree on one.
const COMMON: f64 = 0.2;
/// Largest cosine between the mean up direction and the axis around which the cameras turn for cameras that were held sideways,
/// 45 degrees.
const SIDEWAYS: f64 = 0.7;
/// Largest mean cosine between the direction of view and the axis around which cameras turn, 26 degrees.
const ALONG_VIEW: f64 = 0.9;
/// Least second eigenvalue of the image axes of cameras that stand on an arc, 35 degrees of azimuth.
const ARC: f64 = 0.03;
/// Least second eigenvalue of the vertical image axes of cameras that were held sideways, 65 degrees of azimuth.
const SIDEWAYS_ARC: f64 = 0.1;
/// Least ratio of the second eigenvalues of the vertical and the horizontal image axes of cameras that were held sideways.
const SIDEWAYS_RATIO: f64 = 2.0;
/// Least roll of hand-held cameras that is assumed, radians; 2 degrees.
const LEAST_ROLL: f64 = 0.035;
/// Largest number of cameras whose rolls are independent: in consecutive photographs a person keeps the roll.
const INDEPENDENT: f64 = 8.0;
/// Largest standard deviation of a direction from level image axes, radians; 10 degrees.
const UNCERTAIN: f64 = 0.175;
/// Tolerances of the root mean square roll of the cameras about a plane, radians; 5 and 10 degrees.
const ROLL_TOLERANCE: [f64; 2] = [0.087, 0.175];
/// Least cosine between a plane's normal and the up direction of the cameras: 45 degrees; 20 degrees if the roll of the cameras is
/// unknown.
const NEAR: [f64; 2] = [0.707, 0.94];

/// How the cameras give an up direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum CameraSource {
    /// The direction that is perpendicular to the horizontal image axes of all cameras: people hold a camera level.
    Level,
    /// The direction that is perpendicular to the vertical image axes: the camera was held sideways.
    Sideways,
    /// The axis around which the cameras turn.
    Turning,
    /// The mean up direction of the cameras.
    Mean,
}

/// An up direction from the cameras.
#[derive(Debug, Clone, Copy)]
pub(super) struct CameraUp {
    /// Unit length.
    pub direction: DVec3,
    pub source: CameraSource,
    /// Second moments of the image axes that are level if the camera was held level.
    level: DMat3,
}

impl CameraUp {
    /// The direction of the cameras with camera-to-world `poses` of OpenGL axes. `None` if they have no common one.
    pub(super) fn find(poses: &[DMat4]) -> Option<Self> {
        let mean = mean_up(poses);
        let [horizontal, vertical] = [0, 1].map(|axis| LevelAxes::of(poses, axis));
        let is_sideways = vertical.spread >= SIDEWAYS_ARC.max(SIDEWAYS_RATIO * horizontal.spread);
        let (level, source) = if is_sideways && vertical.is_certain {
            (&vertical, CameraSource::Sideways)
        } else if horizontal.is_certain {
            (&horizontal, CameraSource::Level)
        } else {
            let (direction, source) = by_rotation(poses)?;
            return Some(Self { direction, source, level: horizontal.moments });
        };
        Some(Self { direction: upwards(level.normal, poses, mean), source, level: level.moments })
    }

    /// The mean up direction, or the axis around which the cameras turn if they were held sideways. `None` if they have neither.
    pub(super) fn by_rotation(poses: &[DMat4]) -> Option<DVec3> {
        Some(by_rotation(poses)?.0)
    }

    /// Whether a plane with the unit normal `normal` can be level ground: near the up direction, and the cameras are hardly more
    /// rolled about it than about the up direction.
    pub(super) fn accepts(&self, normal: DVec3) -> bool {
        let roll = |up: DVec3| up.dot(self.level * up).max(0.0).sqrt();
        let own = roll(self.direction);
        let [least, most] = ROLL_TOLERANCE;
        let cosine = normal.dot(self.direction);
        if own > most {
            return cosine >= NEAR[1];
        }
        cosine >= NEAR[0] && roll(normal) <= own.hypot(own.max(least))
    }
}

/// The mean up direction of cameras, at most of length 1.
pub(super) fn mean_up(poses: &[DMat4]) -> DVec3 {
    poses.iter().map(|pose| image_axis(pose, 1)).sum::<DVec3>() / poses.len().max(1) as f64
}

/// Unit length: 0 is the image's right, 1 its up, 2 backwards.
fn image_axis(pose: &DMat4, axis: usize) -> DVec3 {
    pose.col(axis).truncate().normalize_or_zero()
}

/// One image axis of all cameras, as if it were level.
struct LevelAxes {
    moments: DMat3,
    /// The direction most perpendicular to the axes, of either sign.
    normal: DVec3,
    /// Second eigenvalue of the moments: 0.5 for a full circle, 0.03 for an arc of 35 degrees.
    spread: f64,
    /// Whether the axes determine the direction.
    is_certain: bool,
}

impl LevelAxes {
    /// The direction is the eigenvector of the smallest eigenvalue of the second moments. Its variance is that of the roll divided by
    /// the spread and the number of independent cameras, as in a linear regression through the origin.
    fn of(poses: &[DMat4], axis: usize) -> Self {
        let count = poses.len() as f64;
        let sum = poses.iter().map(|pose| outer(image_axis(pose, axis))).sum::<DMat3>();
        let moments = sum * (1.0 / count.max(1.0));
        let found = eigen(moments);
        let [roll, spread, _] = found.values;
        // Two numbers are estimated.
        let roll = (roll.max(0.0) * count / (count - 2.0).max(1.0)).max(LEAST_ROLL * LEAST_ROLL);
        let variance = roll / (spread.max(0.0) * count.min(INDEPENDENT));
        let is_certain = count > 3.0 && spread >= ARC && variance <= UNCERTAIN * UNCERTAIN;
        Self { moments, normal: found.vectors[0], spread, is_certain }
    }
}

/// The mean up direction, or the turning axis if the mean up direction is another one, or none: the camera was held sideways.
fn by_rotation(poses: &[DMat4]) -> Option<(DVec3, CameraSource)> {
    let mean = mean_up(poses);
    match turning_axis(poses).map(|turning| upwards(turning, poses, mean)) {
        Some(up) if mean.dot(up) < SIDEWAYS * mean.length() || mean.length() < COMMON => {
            Some((up, CameraSource::Turning))
        }
        _ if mean.length() < COMMON => None,
        _ => Some((mean.normalize(), CameraSource::Mean)),
    }
}

/// An axis with the sign that points up: along the mean up direction of the cameras. Cameras that were held sideways have
/// none along the axis; most people hold the camera above the object and look down.
fn upwards(axis: DVec3, poses: &[DMat4], mean: DVec3) -> DVec3 {
    let along = mean.dot(axis);
    let down = || poses.iter().map(|pose| image_axis(pose, 2).dot(axis)).sum::<f64>();
    let sign = if along.abs() > COMMON { along } else { down() };
    if sign < 0.0 { -axis } else { axis }
}

/// The axis about which the cameras turn around their object, of either sign: the direction that changes least as seen
/// from the cameras. That is the right singular vector of the mean world-to-camera rotation with the largest singular value. `None` if
/// the cameras hardly turn, or about no common axis.
pub(super) fn turning_axis(poses: &[DMat4]) -> Option<DVec3> {
    let to_camera = |pose: &DMat4| {
        let axes = [0, 1, 2].map(|axis| image_axis(pose, axis).to_array());
        DMat3::from_cols_array_2d(&axes).transpose()
    };
    let mean = poses.iter().map(to_camera).sum::<DMat3>() * (1.0 / poses.len().max(1) as f64);
    let found = eigen(mean.transpose() * mean);
    let ([third, second, largest], [.., axis]) = (found.values, found.vectors);
    let forward = poses.iter().map(|pose| -image_axis(pose, 2)).sum::<DVec3>();
    // Cameras that roll about their common direction of view do not turn around an object.
    let rolls = forward.dot(axis).abs() > ALONG_VIEW * poses.len() as f64;
    (!rolls && largest > 0.5 && second + third < 0.5 * largest).then_some(axis)
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_scene::Camera;

    /// Cameras around the origin, over `degrees` of azimuth, at an elevation of 20 degrees.
    fn orbit(degrees: f64) -> Vec<DMat4> {
        let pose = |i: usize| {
            let angle = (degrees * i as f64 / 16.0).to_radians();
            let eye = DVec3::new(3.0 * angle.cos(), 3.0 * angle.sin(), 1.1);
            Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.8, (8, 6)).unwrap().to_opengl()
        };
        (0..16).map(pose).collect()
    }

    #[test]
    fn turning_axis_is_found_for_orbits_only() {
        for degrees in [360.0, 240.0] {
            let axis = turning_axis(&orbit(degrees)).unwrap();
            assert!(axis.z.abs() > 0.98, "{degrees}: {axis}");
        }
        assert_eq!(turning_axis(&orbit(20.0)), None, "cameras that hardly turn");
        assert_eq!(turning_axis(&[]), None);
    }

    #[test]
    fn cameras_that_roll_about_their_view_turn_around_nothing() {
        let pose = |i: u32| orbit(20.0)[0] * DMat4::from_rotation_z(f64::from(i) * 1.5);
        let rolled: Vec<_> = (0..8).map(pose).collect();
        assert_eq!(turning_axis(&rolled), None);
    }

    #[test]
    fn vertical_sweep_of_an_upright_camera_is_not_sideways() {
        let pose = |i: usize| {
            let (azimuth, elevation) = (0.06 * i as f64, 0.05 * i as f64);
            let eye = 3.0 * DVec3::new(azimuth.cos(), azimuth.sin(), elevation.tan()).normalize();
            Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.8, (8, 6)).unwrap().to_opengl()
        };
        let up = CameraUp::find(&(0..20).map(pose).collect::<Vec<_>>()).unwrap();
        assert_eq!(up.source, CameraSource::Level);
        assert!(up.direction.z > 1.0 - 1e-9, "{up:?}");
        assert!(up.accepts(DVec3::Z) && !up.accepts(DVec3::X) && !up.accepts(DVec3::NEG_Z));
        assert!(!up.accepts(DVec3::NAN));
    }

    #[test]
    fn few_cameras_have_only_a_mean() {
        let poses = orbit(120.0);
        for count in 1..=3 {
            let up = CameraUp::find(&poses[..count]).unwrap();
            assert_eq!(up.source, CameraSource::Mean, "{count}");
        }
        assert!(CameraUp::find(&[]).is_none());
        assert_eq!(CameraUp::find(&poses).unwrap().source, CameraSource::Level, "the control");
    }
}
