//! Converts poses that do not follow the convention of their layout (camera-to-world matrices with OpenGL axes), if no other
//! reading is plausible.

use glam::{DMat4, DVec3};

use crate::camera_up::mean_up;
use crate::formats::ply_points::Point;
use crate::photos::PhotoEntry;
use crate::rig;

/// Fewest cameras whose matrices are inverted.
const MIN_CAMERAS: usize = 8;
/// Greatest share of the cameras that may look at one point in the stated reading, if the poses have another convention.
const FEW_LOOK: f64 = 0.25;
/// Length of the mean up direction above which cameras have a common one.
const COMMON_UP: f64 = 0.5;

/// Between OpenGL axes (y up, z backward) and OpenCV axes (y down, z forward) of a camera.
fn flip() -> DMat4 {
    DMat4::from_scale(DVec3::new(1.0, -1.0, -1.0))
}

/// Converts world-to-camera poses, then poses with OpenCV axes, to camera-to-world poses with OpenGL axes, if they are surely such.
/// Each conversion adds a warning. `points` have the axes of the poses.
pub(super) fn convert(photos: &mut [PhotoEntry], points: &[Point], warnings: &mut Vec<String>) {
    invert_world_to_camera(photos, points, warnings);
    convert_opencv_axes(photos, warnings);
}

/// Inverts world-to-camera matrices.
///
/// The matrices of cameras around an object, read as camera-to-world, are cameras at almost one place that look in directions of
/// one fan and are rolled. The matrices of a panorama of several rows, read as world-to-camera, are rolled cameras on an arc
/// that look at one point. Therefore all three are required: inverted, all cameras look at one point; as stated, with either kind
/// of axes, at most [`FEW_LOOK`] do; and the inverted cameras alone see the points, or without points have a common up
/// direction. If only the first two hold, a warning has the numbers and the remedy, and the poses stay.
fn invert_world_to_camera(photos: &mut [PhotoEntry], points: &[Point], warnings: &mut Vec<String>) {
    let stated: Vec<DMat4> = photos.iter().map(|photo| photo.pose).collect();
    let with_other_axes: Vec<DMat4> = stated.iter().map(|pose| *pose * flip()).collect();
    let looking = [&stated, &with_other_axes].map(|poses| rig::looking_straight(poses));
    let most = looking[0].max(looking[1]);
    if stated.len() < MIN_CAMERAS || most as f64 > FEW_LOOK * stated.len() as f64 {
        return;
    }
    let opengl: Vec<DMat4> = stated.iter().map(DMat4::inverse).collect();
    let opencv: Vec<DMat4> = opengl.iter().map(|pose| *pose * flip()).collect();
    let readings = [(opengl, ""), (opencv, " with OpenCV axes (y down, z forward)")];
    let plausible = readings.into_iter().find(|(poses, _)| rig::looking_straight(poses) == poses.len());
    let Some((inverted, axes)) = plausible else { return };
    let evidence = format!(
        "as stated, {most} of {} cameras look at one point, and with the matrices inverted all do",
        stated.len()
    );
    if !is_decisive([&stated, &with_other_axes], &inverted, points) {
        warnings.push(format!(
            "the poses may be world-to-camera{axes} instead of camera-to-world: {evidence}; invert the matrices if the photographs show \
             an object from its sides; a panorama needs no change"
        ));
        return;
    }
    photos.iter_mut().zip(inverted).for_each(|(photo, pose)| photo.pose = pose);
    warnings.push(format!(
        "the poses are world-to-camera{axes} where the layout has camera-to-world: {evidence}; the matrices are inverted"
    ));
}

/// Whether the points, or without points the up directions of the cameras, decide for the inverted poses.
fn is_decisive(stated: [&[DMat4]; 2], inverted: &[DMat4], points: &[Point]) -> bool {
    let seen = |poses: &[DMat4]| rig::seeing(poses, points).map(|seeing| seeing as f64 / poses.len() as f64);
    match (seen(inverted), stated.map(seen)) {
        (Some(inverted), [Some(a), Some(b)]) => inverted > 0.9 && a.max(b) < 0.5,
        _ => mean_up(inverted).length() > COMMON_UP && mean_up(stated[0]).length() < COMMON_UP,
    }
}

/// Converts poses with OpenCV axes (y down, z forward) to OpenGL axes (y up, z backward) if they are surely such: taken
/// as OpenGL axes, the cameras look away from the object and are upside down.
fn convert_opencv_axes(photos: &mut [PhotoEntry], warnings: &mut Vec<String>) {
    let poses: Vec<DMat4> = photos.iter().map(|photo| photo.pose).collect();
    if mean_up(&poses).z < -0.5 && 10 * rig::looking(&poses) < poses.len() {
        photos.iter_mut().for_each(|photo| photo.pose *= flip());
        warnings.push(
            "the poses have OpenCV axes (y down, z forward) where the layout has OpenGL axes (y up, z backward): the cameras would \
             look away and be upside down; the poses are converted"
                .to_owned(),
        );
    }
}
