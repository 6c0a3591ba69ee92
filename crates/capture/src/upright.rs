//! Rotates the world of a capture so that +Z is up, as environment maps need it.

use glam::{DMat3, DMat4, DQuat, DVec3};
use relume_spec::training::UpAxis;

use crate::formats::ply_points::Point;
use crate::photos::PhotoEntry;

/// Least cosine between +Z and the mean up direction of the cameras for a world that is +Z up, 60 degrees.
const UPRIGHT: f64 = 0.5;
/// Least cosine between the estimated up direction and an axis of the world that it stands for, 20 degrees.
const NEAR_AXIS: f64 = 0.94;
/// Largest cosine between the mean up direction and the axis around which the cameras turn for cameras that were held sideways,
/// 45 degrees.
const SIDEWAYS: f64 = 0.7;
/// Largest mean cosine between the direction of view and the axis around which cameras turn, 26 degrees.
const ALONG_VIEW: f64 = 0.9;
/// Least length of the mean up direction of cameras that agree on one.
const COMMON: f64 = 0.2;

/// Whether a layout states which direction of its world is up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum StatedUp {
    /// +Z is up by convention, which some programs ignore.
    PlusZ,
    /// The layout has arbitrary axes; the name of the program that chose them.
    No(&'static str),
}

/// The rotation of the world that makes +Z up. `poses` are camera-to-world with OpenGL axes. A layout that states +Z is rotated
/// only if `choice` says so; cameras that disagree with it give a warning.
pub(super) fn upright(
    poses: &[DMat4],
    choice: UpAxis,
    stated: StatedUp,
    warnings: &mut Vec<String>,
) -> DQuat {
    if let Some(axis) = axis(choice) {
        return rotation(axis);
    }
    let ups = poses.iter().map(|pose| pose.y_axis.truncate().normalize_or_zero());
    let mean = ups.sum::<DVec3>() / poses.len().max(1) as f64;
    let StatedUp::No(program) = stated else {
        warnings.extend(other_axis(poses, mean));
        return DQuat::IDENTITY;
    };
    match turning_axis(poses).map(|turning| upwards(turning, poses, mean)) {
        // The camera was held sideways: the mean up direction is another one, or there is none.
        Some(up) if mean.dot(up) < SIDEWAYS * mean.length() || mean.length() < COMMON => rotation(up),
        _ if mean.length() < COMMON => {
            warnings.push(format!(
                "the cameras have no common up direction; the world keeps its {program} axes; state the axis with --up"
            ));
            DQuat::IDENTITY
        }
        _ => rotation(mean.normalize()),
    }
}

/// The turning axis with the sign that points up: along the mean up direction of the cameras. Cameras that were held sideways have
/// none along the axis; most people hold the camera above the object and look down.
fn upwards(turning: DVec3, poses: &[DMat4], mean: DVec3) -> DVec3 {
    let along = mean.dot(turning);
    let down =
        || poses.iter().map(|pose| pose.z_axis.truncate().normalize_or_zero().dot(turning)).sum::<f64>();
    let sign = if along.abs() > COMMON { along } else { down() };
    if sign < 0.0 { -turning } else { turning }
}

/// Rotates poses and points.
pub(super) fn rotate(rotation: DQuat, photos: &mut [PhotoEntry], points: &mut [Point]) {
    if rotation != DQuat::IDENTITY {
        photos.iter_mut().for_each(|photo| photo.pose = DMat4::from_quat(rotation) * photo.pose);
        points.iter_mut().for_each(|(position, _)| *position = rotation * *position);
    }
}

/// A warning for a world that should be +Z up and is not, with the axis that is up instead, if there is one.
fn other_axis(poses: &[DMat4], mean: DVec3) -> Option<String> {
    let is_common = mean.length() > 0.5;
    if !is_common || mean.normalize().z >= UPRIGHT {
        return None;
    }
    let (_, (name, flag), axis) = AXES
        .into_iter()
        .map(|(name, axis)| (axis.dot(mean), name, axis))
        .max_by(|a, b| a.0.total_cmp(&b.0))?;
    let is_axis = turning_axis(poses).is_some_and(|turning| turning.dot(axis).abs() > NEAR_AXIS);
    let cause = if is_axis {
        format!("probably {name} is up: train with --up {flag}")
    } else {
        "state the axis that is up with --up".to_owned()
    };
    Some(format!(
        "the mean up direction of the cameras is ({:.2}, {:.2}, {:.2}), not +Z: environment maps will shine from the side; {cause}",
        mean.x, mean.y, mean.z
    ))
}

/// Axes with their names and the values of `--up`.
const AXES: [((&str, &str), DVec3); 6] = [
    (("+X", "x"), DVec3::X),
    (("+Y", "y"), DVec3::Y),
    (("+Z", "z"), DVec3::Z),
    (("-X", "-x"), DVec3::NEG_X),
    (("-Y", "-y"), DVec3::NEG_Y),
    (("-Z", "-z"), DVec3::NEG_Z),
];

fn axis(choice: UpAxis) -> Option<DVec3> {
    Some(match choice {
        UpAxis::Auto => return None,
        UpAxis::X => DVec3::X,
        UpAxis::Y => DVec3::Y,
        UpAxis::Z => DVec3::Z,
        UpAxis::NegX => DVec3::NEG_X,
        UpAxis::NegY => DVec3::NEG_Y,
        UpAxis::NegZ => DVec3::NEG_Z,
    })
}

fn rotation(up: DVec3) -> DQuat {
    DQuat::from_rotation_arc(up, DVec3::Z)
}

/// The axis about which the cameras turn around their object, of either sign: the direction that changes least as seen
/// from the cameras. That is the right singular vector of the mean world-to-camera rotation with the largest singular value. `None` if the cameras
/// hardly turn, or about no common axis.
fn turning_axis(poses: &[DMat4]) -> Option<DVec3> {
    let to_camera = |pose: &DMat4| {
        let axes = [pose.x_axis, pose.y_axis, pose.z_axis].map(|axis| axis.truncate().normalize_or_zero());
        DMat3::from_cols_array_2d(&axes.map(|axis| axis.to_array())).transpose()
    };
    let mean = poses.iter().map(to_camera).sum::<DMat3>() * (1.0 / poses.len().max(1) as f64);
    let squared = mean.transpose() * mean;
    // The power iteration converges if the largest of the three eigenvalues is well above the second, which is asked for below.
    let mut axis = DVec3::new(0.57, 0.58, 0.59);
    for _ in 0..200 {
        axis = (squared * axis).normalize_or_zero();
    }
    let largest = axis.dot(squared * axis);
    let trace = squared.x_axis.x + squared.y_axis.y + squared.z_axis.z;
    let second = (trace - largest).max(0.0);
    let forward = poses.iter().map(|pose| -pose.z_axis.truncate().normalize_or_zero()).sum::<DVec3>();
    // Cameras that roll about their common direction of view do not turn around an object.
    let rolls = forward.dot(axis).abs() > ALONG_VIEW * poses.len() as f64;
    (axis != DVec3::ZERO && !rolls && largest > 0.5 && second < 0.5 * largest).then_some(axis)
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

    fn rotated(poses: &[DMat4], rotation: DQuat) -> Vec<DMat4> {
        poses.iter().map(|pose| DMat4::from_quat(rotation) * *pose).collect()
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
    fn world_of_another_axis_is_reported_with_the_axis() {
        let poses = orbit(360.0);
        let mut warnings = Vec::new();
        assert_eq!(upright(&poses, UpAxis::Auto, StatedUp::PlusZ, &mut warnings), DQuat::IDENTITY);
        assert!(warnings.is_empty());
        for ((name, flag), axis) in AXES.into_iter().filter(|((name, _), _)| *name != "+Z") {
            let poses = rotated(&poses, DQuat::from_rotation_arc(DVec3::Z, axis));
            let mut warnings = Vec::new();
            assert_eq!(upright(&poses, UpAxis::Auto, StatedUp::PlusZ, &mut warnings), DQuat::IDENTITY);
            let expected = format!("probably {name} is up: train with --up {flag}");
            assert!(warnings.len() == 1 && warnings[0].ends_with(&expected), "{warnings:?}");
            let choice: UpAxis = serde_json::from_value(flag.into()).unwrap();
            let turn = upright(&poses, choice, StatedUp::PlusZ, &mut warnings);
            assert!((turn * axis - DVec3::Z).length() < 1e-12 && warnings.len() == 1, "{name}: {turn}");
        }
    }

    #[test]
    fn cameras_that_roll_about_their_view_turn_around_nothing() {
        let pose = |i: u32| orbit(20.0)[0] * DMat4::from_rotation_z(f64::from(i) * 1.5);
        let rolled: Vec<_> = (0..8).map(pose).collect();
        assert_eq!(turning_axis(&rolled), None);
    }

    #[test]
    fn cameras_held_sideways_give_the_upright_world() {
        let away = DQuat::from_euler(glam::EulerRot::XYZ, 0.4, 1.1, -0.6);
        for roll in [0.0, 90.0, -90.0, 180.0f64] {
            let held =
                |pose: &DMat4| DMat4::from_quat(away) * *pose * DMat4::from_rotation_z(roll.to_radians());
            let poses: Vec<_> = orbit(360.0).iter().map(held).collect();
            let turn = upright(&poses, UpAxis::Auto, StatedUp::No("COLMAP"), &mut Vec::new());
            // Held upside down, the world is upside down as well: nothing tells which is meant.
            let expected = if roll == 180.0 { DVec3::NEG_Z } else { DVec3::Z };
            assert!((turn * (away * DVec3::Z) - expected).length() < 1e-6, "{roll}");
        }
    }

    #[test]
    fn unclear_cameras_give_a_warning_without_an_axis() {
        let away = DQuat::from_rotation_z(0.8) * DQuat::from_rotation_x(1.5);
        let mut warnings = Vec::new();
        let kept = upright(&rotated(&orbit(360.0), away), UpAxis::Auto, StatedUp::PlusZ, &mut warnings);
        assert_eq!(kept, DQuat::IDENTITY);
        assert!(
            warnings.len() == 1 && warnings[0].ends_with("state the axis that is up with --up"),
            "{warnings:?}"
        );
    }
}
