//! The views of the frames: a camera and a rotation of the light each.

use super::args::CameraArgs;
use crate::cli::error::CommandResult;
use relume_scene::Model;
use relume_train::render::{FrameView, Turntable, linked, orbit_camera, rotate_light};

/// The views of the frames, in order: cameras of a file, a turntable or a single image.
pub(super) fn views(
    args: &CameraArgs,
    file_cameras: Option<Vec<FrameView>>,
    model: &Model,
) -> CommandResult<Vec<FrameView>> {
    let size = args.resolution.unwrap_or((args.size, args.size));
    let mut views = match (file_cameras, args.turntable) {
        (Some(views), _) => views,
        (None, Some(frames)) => {
            let (azimuth_deg, elevation_deg) = (args.azimuth, args.elevation);
            let camera_turn_deg = args.camera_turn;
            Turntable { frames, azimuth_deg, elevation_deg, camera_turn_deg, size }.views(model)?
        }
        (None, None) => {
            let camera = orbit_camera(model, args.azimuth, args.elevation, size)?;
            vec![FrameView::new(camera, 0.0)]
        }
    };
    rotate_light(&mut views, args.env_turn);
    Ok(linked(views))
}
