//! Recognises a subject that turned in front of a still camera and derives the rotation of the light from the poses.
//!
//! The poses of such a capture are in the frame of the subject. In this frame the camera moves around the subject, and the room with its
//! light rotates by the same angle as the camera. The evidence is the background: it moves much less between successive
//! photographs than it would around a subject that stands still.

use glam::{DMat3, DVec3};
use relume_spec::training::TurntableCapture;

use crate::{CaptureError, CaptureView};
use relume_scene::{Camera, PackedImage, Plane};

/// Name of the setting, for errors.
const FIELD: &str = "turntable_capture";
/// Longest side of the images in which the background is compared, pixels.
const SIDE: u32 = 64;
/// Least number of background pixels that two photographs share.
const MIN_PIXELS: usize = 64;
/// Range of the predicted motion of the background, pixels. Larger motions are compared at the upper end.
const MOTION: (f64, f64) = (2.0, SIDE as f64 / 4.0);
/// Least root mean square difference, over the three channels, of a background and the same background moved as predicted. A
/// smooth background cannot show whether it moves.
const MIN_DETAIL: f64 = 0.03;
/// Largest mean square difference of two photographs' backgrounds, relative to that of the moved background, of a still one.
const STILL: f64 = 0.5;
/// Least share of the pairs of photographs with a still background, and least number of pairs.
const MIN_STILL: (f64, usize) = (0.9, 8);
/// Least angle that the turns span, degrees.
const MIN_SPAN_DEG: f64 = 90.0;
/// Least span of the turns that a caller states, degrees.
const MIN_STATED_SPAN_DEG: f64 = 5.0;
/// Largest median angle between a camera and the first one turned about +Z, degrees, of a camera that stood still.
const MAX_TILT_DEG: f64 = 10.0;

/// Sets the rotations of the light of the photographs of a turntable capture, and returns a note that says so. `None` if the
/// light does not rotate, or if the files already state rotations and `choice` leaves the decision to the evidence.
///
/// # Errors
/// [`CaptureError::Field`] if `choice` states a turntable but the files state rotations or the cameras do not turn.
pub(super) fn derive_rotations(
    views: &mut [&mut CaptureView],
    choice: TurntableCapture,
) -> Result<Option<String>, CaptureError> {
    if choice == TurntableCapture::No {
        return Ok(None);
    }
    views.sort_by(|a, b| a.name.cmp(&b.name));
    let cameras: Vec<Camera> = views.iter().map(|view| view.camera).collect();
    let turns = turns(&cameras);
    let has_rotations = views.iter().any(|view| view.light_rotation_deg != 0.0);
    let evidence = match choice {
        TurntableCapture::Yes => {
            check_stated(has_rotations, &turns)?;
            "as turntable_capture states"
        }
        _ if has_rotations || !(turns.span_deg() >= MIN_SPAN_DEG && turns.tilt_deg <= MAX_TILT_DEG) => {
            return Ok(None);
        }
        _ if views.iter().all(|view| view.image.is_opaque()) || !has_still_background(views, &cameras) => {
            return Ok(None);
        }
        _ => {
            "the background stands still while the cameras turn; if that is wrong, set turntable_capture to `no`"
        }
    };
    let span = turns.span_deg();
    views.iter_mut().zip(&turns.degrees).for_each(|(view, turn)| view.light_rotation_deg = *turn);
    Ok(Some(format!("turntable: the light of the photographs rotates over {span:.0} degrees ({evidence})")))
}

/// # Errors
/// The reason why the photographs cannot be those of a turntable.
fn check_stated(has_rotations: bool, turns: &Turns) -> Result<(), CaptureError> {
    let span = turns.span_deg();
    let reason = if has_rotations {
        "must not be `yes`: the files of the capture state rotations of the light".to_owned()
    } else if !(span >= MIN_STATED_SPAN_DEG) {
        format!(
            "must not be `yes`: the cameras span {span:.0} degrees around the up direction, so nothing turned"
        )
    } else {
        return Ok(());
    };
    Err(CaptureError::at_field("the capture", FIELD, reason))
}

/// Rotations of cameras about +Z relative to the first one.
struct Turns {
    /// Degrees counter-clockwise seen from above, -180 to 180.
    degrees: Vec<f64>,
    /// Median angle between a camera and the rotated first one, degrees.
    tilt_deg: f64,
}

impl Turns {
    /// 360 degrees less the largest gap between turns.
    fn span_deg(&self) -> f64 {
        let mut sorted: Vec<f64> = self.degrees.iter().map(|turn| turn.rem_euclid(360.0)).collect();
        sorted.sort_by(f64::total_cmp);
        let around = sorted.first().map(|first| first + 360.0);
        let next = sorted.iter().copied().skip(1).chain(around);
        360.0 - sorted.iter().zip(next).map(|(a, b)| b - a).fold(0.0, f64::max)
    }
}

/// The rotation about +Z that brings the first camera nearest to each camera: it maximises the trace of the product of the
/// rotation and `first * camera^T`.
fn turns(cameras: &[Camera]) -> Turns {
    let first = cameras.first().map_or(DMat3::IDENTITY, |camera| camera.rotation.transpose());
    let (mut degrees, mut tilts) = (Vec::new(), Vec::new());
    for camera in cameras {
        let relative = first * camera.rotation;
        let [x, y, z] = [relative.x_axis, relative.y_axis, relative.z_axis];
        let (sine, cosine) = (y.x - x.y, x.x + y.y);
        degrees.push(sine.atan2(cosine).to_degrees());
        tilts.push(((sine.hypot(cosine) + z.z - 1.0) / 2.0).clamp(-1.0, 1.0).acos().to_degrees());
    }
    tilts.sort_by(f64::total_cmp);
    Turns { degrees, tilt_deg: tilts.get(tilts.len() / 2).copied().unwrap_or(0.0) }
}

/// Whether the background moves less between successive photographs than the poses predict for a subject that stands still.
fn has_still_background(views: &[&mut CaptureView], cameras: &[Camera]) -> bool {
    let images: Vec<Plane<4>> = views.iter().map(|view| reduced(&view.image)).collect();
    let mut still = 0;
    let mut pairs = 0;
    for (i, pair) in images.windows(2).enumerate() {
        let motion = angle(&cameras[i], &cameras[i + 1]) * focal_length(&cameras[i], &pair[0]);
        let Some(share) = motion_share(&pair[0], &pair[1], motion) else { continue };
        pairs += 1;
        still += usize::from(share < STILL);
    }
    pairs >= MIN_STILL.1 && still as f64 >= MIN_STILL.0 * pairs as f64
}

/// Angle between the directions of view of two cameras, radians.
fn angle(a: &Camera, b: &Camera) -> f64 {
    let forward = |camera: &Camera| camera.rotation.transpose() * DVec3::Z;
    forward(a).dot(forward(b)).clamp(-1.0, 1.0).acos()
}

/// Focal length in pixels of a reduced image.
fn focal_length(camera: &Camera, image: &Plane<4>) -> f64 {
    camera.fx * f64::from(image.width) / f64::from(camera.width.max(1))
}

/// Mean square difference of the backgrounds of `a` and `b`, relative to that of `a` and itself moved by `motion` pixels along the
/// rows. `None` if this cannot tell a still background from a moving one.
fn motion_share(a: &Plane<4>, b: &Plane<4>, motion: f64) -> Option<f64> {
    if motion < MOTION.0 || (a.width, a.height) != (b.width, b.height) {
        return None;
    }
    let by = motion.min(MOTION.1).round() as usize;
    let width = a.width as usize;
    let in_row = |i: &usize| i % width + by < width;
    let moved = mean_square((0..a.values.len()).filter(in_row).map(|i| (&a.values[i], &a.values[i + by])))?;
    let between = mean_square(a.values.iter().zip(&b.values))?;
    (moved >= MIN_DETAIL * MIN_DETAIL).then(|| between / moved)
}

/// Mean over the pairs of background pixels of the squared distance of their colours; `None` if they are too few.
fn mean_square<'a>(pairs: impl Iterator<Item = (&'a [f32; 4], &'a [f32; 4])>) -> Option<f64> {
    // A pixel at the edge of a mask has the colour of the subject, however small its alpha is.
    let is_background = |pixel: &[f32; 4]| pixel[3] <= 0.0;
    let (mut sum, mut count) = (0.0, 0);
    for (p, q) in pairs.filter(|(p, q)| is_background(p) && is_background(q)) {
        sum += (0..3).map(|c| f64::from(p[c] - q[c]).powi(2)).sum::<f64>();
        count += 1;
    }
    (count >= MIN_PIXELS).then(|| sum / f64::from(count as u32))
}

/// A small image of a photograph. Alpha does not weight the colours, so that those behind a mask count too.
fn reduced(image: &PackedImage) -> Plane<4> {
    let (width, height) = (image.width, image.height);
    let longest = width.max(height).max(1);
    let side =
        |s: u32| (u64::from(s) * u64::from(SIDE.min(longest))).div_ceil(u64::from(longest)).max(1) as u32;
    Plane { width, height, values: image.pixels().collect() }.resized(side(width), side(height))
}

#[cfg(test)]
mod tests;
