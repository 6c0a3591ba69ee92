//! From the fields of a render request to a camera and a quality; a refusal names the field.

use glam::{DMat4, DVec3};

use crate::api::Problem;
use crate::api::cameras::{CameraAxes, CameraSpec};
use crate::api::renders::RenderRequest;
use crate::render::{Finish, FrameFormat, Output, Quality, RenderError, Tier, is_colour};
use crate::scene::{Camera, CameraError};

/// Longest side of a frame, pixels.
const MAX_SIDE: u32 = 4096;
/// Most queries through the Gaussians a frame of the reference tier may cost: some seconds of the device thread.
const MOST_QUERIES: u64 = 1 << 21;

/// The tier and samples asked for; refuses a frame that would occupy the device thread for too long.
pub(super) fn quality(request: &RenderRequest) -> Result<Quality, Problem> {
    let quality = Quality {
        tier: request.tier,
        samples: request.samples.unwrap_or(Quality::SAMPLES),
        seed: request.seed.unwrap_or(0),
    };
    let most = match request.tier {
        Tier::MonteCarlo => MOST_QUERIES / (u64::from(request.width) * u64::from(request.height)).max(1),
        _ => u64::MAX,
    };
    let most = most.min(u64::from(Quality::MOST_SAMPLES));
    if !(1..=most).contains(&u64::from(quality.samples)) {
        let detail = match most {
            0 => format!("the tier monte_carlo takes pictures of at most {MOST_QUERIES} pixels"),
            most => format!("must be 1 to {most} at this tier and size, got {}", quality.samples),
        };
        return Err(Problem::invalid_field("/samples", detail));
    }
    Ok(quality)
}

/// Refuses outputs that no file of the format holds.
pub(super) fn check_outputs(outputs: &[Output], format: FrameFormat) -> Result<(), Problem> {
    let refuse = |why: &str| Err(Problem::invalid_field("/outputs", why));
    if let Some(i) = (1..outputs.len()).find(|&i| outputs[..i].contains(&outputs[i])) {
        return Err(Problem::invalid_field(format!("/outputs/{i}"), "is named twice"));
    }
    match (outputs, format) {
        ([], _) => refuse("must name at least one output"),
        ([_], FrameFormat::Png) | (_, FrameFormat::Exr) => Ok(()),
        ([one], FrameFormat::Jpeg) if is_colour(*one) => Ok(()),
        ([_], FrameFormat::Jpeg) => {
            refuse("is data, which JPEG would spoil; accept image/png or image/x-exr")
        }
        _ => refuse("only image/x-exr holds several outputs"),
    }
}

/// How the picture is finished; refuses what the format cannot show.
pub(super) fn finish(request: &RenderRequest, format: FrameFormat) -> Result<Finish, Problem> {
    let finish = Finish {
        background: request.background,
        tone_curve: request.tone_curve,
        colour_depth: request.colour_depth,
        ..Finish::default()
    };
    match finish.check(&request.outputs, format) {
        Err(RenderError::Refused { field, reason }) => {
            Err(Problem::invalid_field(format!("/{field}"), reason))
        }
        other => other.map(|()| finish).map_err(Problem::internal),
    }
}

/// The camera asked for.
pub(super) fn camera(request: &RenderRequest) -> Result<Camera, Problem> {
    for (field, side) in [("/width", request.width), ("/height", request.height)] {
        if !(1..=MAX_SIDE).contains(&side) {
            return Err(Problem::invalid_field(field, format!("must be 1 to {MAX_SIDE}, got {side}")));
        }
    }
    let size = (request.width, request.height);
    let spec = &request.camera;
    if spec.axes.is_some() && spec.camera_to_world.is_none() {
        return Err(Problem::invalid_field("/camera/axes", "goes with camera_to_world"));
    }
    let refused = |error: CameraError| camera_refused("/camera", &error);
    match (&spec.look_at, &spec.camera_to_world, &spec.colmap) {
        (Some(look), None, None) => {
            if spec.fov_y_deg.is_some() || spec.intrinsics.is_some() {
                let detail = "look_at brings its own fov_y_deg; intrinsics go with camera_to_world or colmap";
                return Err(Problem::invalid_field("/camera", detail));
            }
            let [eye, target, up] = [look.eye, look.target, look.up].map(DVec3::from_array);
            Camera::look_at(eye, target, up, look.fov_y_deg.to_radians(), size)
                .map_err(|e| camera_refused("/camera/look_at", &e))
        }
        (None, Some(rows), None) => {
            let (focal, centre) = intrinsics(spec, size)?;
            let matrix = DMat4::from_cols_array_2d(rows).transpose();
            let made = match spec.axes.unwrap_or_default() {
                CameraAxes::Opengl => Camera::from_opengl(&matrix, size, focal, centre),
                CameraAxes::Opencv => Camera::from_opencv(&matrix, size, focal, centre),
            };
            made.map_err(refused)
        }
        (None, None, Some(pose)) => {
            let (focal, centre) = intrinsics(spec, size)?;
            Camera::from_colmap(pose.qvec, pose.tvec, size, focal, centre).map_err(refused)
        }
        _ => {
            let detail = "must have one of look_at, camera_to_world and colmap";
            Err(Problem::invalid_field("/camera", detail))
        }
    }
}

type Pair = (f64, f64);

/// Focal lengths and principal point in pixels.
fn intrinsics(spec: &CameraSpec, (width, height): (u32, u32)) -> Result<(Pair, Pair), Problem> {
    match (&spec.intrinsics, spec.fov_y_deg) {
        (Some(i), None) => Ok(((i.fx, i.fy), (i.cx, i.cy))),
        (None, Some(fov)) if fov > 0.0 && fov < 180.0 => {
            let focal = 0.5 * f64::from(height) / (0.5 * fov.to_radians()).tan();
            Ok(((focal, focal), (0.5 * f64::from(width), 0.5 * f64::from(height))))
        }
        (None, Some(_)) => {
            Err(Problem::invalid_field("/camera/fov_y_deg", "must lie strictly between 0 and 180"))
        }
        _ => Err(Problem::invalid_field("/camera", "must have either fov_y_deg or intrinsics")),
    }
}

/// Translates the field names of [`Camera`] to those of the request.
fn camera_refused(base: &str, error: &CameraError) -> Problem {
    let pointer = match error.field {
        "transform_matrix" => format!("{base}/camera_to_world"),
        field @ ("qvec" | "tvec") => format!("{base}/colmap/{field}"),
        "fov_y" => format!("{base}/fov_y_deg"),
        field @ ("fx" | "fy" | "cx" | "cy") => format!("{base}/intrinsics/{field}"),
        field => format!("{base}/{field}"),
    };
    Problem::invalid_field(pointer, error.reason.clone())
}
