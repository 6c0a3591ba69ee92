//! The cameras of a capture, without its pixels.

use std::path::Path;

use rayon::prelude::*;

use crate::capture::photos::{self, Split};
use crate::capture::{CaptureError, ImportLimits, Source, import};
use crate::scene::Camera;

/// The camera of a photograph.
#[derive(Debug, Clone, PartialEq)]
pub struct PhotoCamera {
    /// The image's name in the capture, e.g. `train_007/rgba.png`.
    pub name: String,
    /// Whether trainings leave it out, to be judged by it.
    pub is_held_out: bool,
    /// Pose and intrinsics at the stored size, distortion removed.
    pub camera: Camera,
    /// Turn of the light about +Z against the other photographs, degrees counter-clockwise seen from above.
    pub light_rotation_deg: f64,
}

/// The cameras of a folder, zip, tar or tar.gz, in the order in which it names them: those of [`crate::capture::import`] at full
/// resolution. Of the images only the headers are decoded.
///
/// # Errors
/// [`CaptureError`] names the file and field at fault.
pub fn cameras(path: &Path, limits: &ImportLimits) -> Result<Vec<PhotoCamera>, CaptureError> {
    let source = Source::open(path, limits)?;
    let (_, photos, _) = import::read_layout(&source, &mut Vec::new())?;
    let cameras: Vec<_> = photos.par_iter().map(|photo| photos::stored_camera(&source, photo)).collect();
    let splits = import::splits(&photos);
    let described = photos.into_iter().zip(splits).zip(cameras);
    let described = described.map(|((photo, split), camera)| {
        let (is_held_out, light_rotation_deg) = (split == Split::Test, photo.light_rotation_deg);
        Ok(PhotoCamera { name: photo.image, is_held_out, camera: camera?, light_rotation_deg })
    });
    described.collect()
}
