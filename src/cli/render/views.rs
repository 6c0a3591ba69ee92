//! What each frame shows: a camera, and how the light stands.

use super::args::CameraArgs;
use crate::cli::error::CommandResult;
use crate::render::{Orbit, Viewpoint};
use crate::scene::{Camera, Model};

/// What a frame shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct View {
    /// From where, capture units.
    pub camera: Camera,
    /// Turn of the light about +Z beside what holds for all frames, degrees counter-clockwise.
    pub light_turn_deg: f64,
}

/// What the frames show, in their order: cameras of a file, a turntable or one picture.
pub(super) fn views(
    args: &CameraArgs,
    file_cameras: Option<Vec<View>>,
    model: &Model,
) -> CommandResult<Vec<View>> {
    let mut views = match (file_cameras, args.turntable) {
        (Some(views), _) => views,
        (None, Some(frames)) => turntable(args, frames, model)?,
        (None, None) => vec![View { camera: orbit(args, args.azimuth, model)?, light_turn_deg: 0.0 }],
    };
    let frames = views.len() as f64;
    for (i, view) in views.iter_mut().enumerate() {
        view.light_turn_deg += args.env_turn * i as f64 / frames;
    }
    Ok(views)
}

fn turntable(args: &CameraArgs, frames: u32, model: &Model) -> CommandResult<Vec<View>> {
    let start = Orbit { azimuth_deg: args.azimuth, elevation_deg: args.elevation, size: args.size };
    let start = start.azimuth_of(model);
    let azimuth = |i: u32| start + args.camera_turn * f64::from(i) / f64::from(frames);
    let view = |i| Ok(View { camera: orbit(args, Some(azimuth(i)), model)?, light_turn_deg: 0.0 });
    (0..frames).map(view).collect()
}

/// A camera around the model. A picture that is not square shows more along its longer side.
fn orbit(args: &CameraArgs, azimuth_deg: Option<f64>, model: &Model) -> CommandResult<Camera> {
    let (width, height) = args.resolution.unwrap_or((args.size, args.size));
    let orbit = Orbit { azimuth_deg, elevation_deg: args.elevation, size: width.min(height) };
    let camera = Viewpoint::Orbit(orbit).camera(model)?;
    Ok(Camera { width, height, cx: 0.5 * f64::from(width), cy: 0.5 * f64::from(height), ..camera })
}
