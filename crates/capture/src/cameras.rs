//! The cameras of a capture, without its pixels.

use std::path::Path;

use glam::DMat4;
use rayon::prelude::*;

use crate::photos::{self, PhotoEntry, Split};
use crate::truth::TruthFiles;
use crate::{CaptureError, CaptureFiles, ImportLimits, Up, colmap, import, transforms};
use relume_scene::Camera;

/// The camera of a photograph.
#[derive(Debug, Clone, PartialEq)]
pub struct PhotoCamera {
    /// The image's name in the capture, e.g. `train_007/rgba.png`.
    pub name: String,
    /// Whether the photograph is held out of training, for evaluation.
    pub is_held_out: bool,
    /// Pose and intrinsics at the stored size, distortion removed.
    pub camera: Camera,
    /// Rotation of the light about +Z relative to the other photographs, degrees, counter-clockwise seen from above.
    pub light_rotation_deg: f64,
}

/// The cameras of a folder, zip, tar or tar.gz, in the order in which the layout names them. They are those of
/// [`crate::import`] at full resolution, with the same `up`. Only the headers of the images are decoded.
///
/// # Errors
/// [`CaptureError`] names the file and field at fault.
pub fn cameras(
    path: &Path,
    limits: &ImportLimits,
    up: impl Into<Up>,
) -> Result<Vec<PhotoCamera>, CaptureError> {
    let source = CaptureFiles::open(path, limits)?;
    let layout = import::read_layout(&source, up.into(), &mut Vec::new())?;
    of_photos(&source, &layout.photos)
}

/// The cameras of photographs, in their order.
///
/// # Errors
/// As [`cameras`].
pub(super) fn of_photos(
    source: &CaptureFiles,
    photos: &[PhotoEntry],
) -> Result<Vec<PhotoCamera>, CaptureError> {
    let cameras: Vec<_> = photos.par_iter().map(|photo| photos::stored_camera(source, photo)).collect();
    let described = photos.iter().zip(import::splits(photos)).zip(cameras);
    let described = described.map(|((photo, split), camera)| {
        let (is_held_out, light_rotation_deg) = (split == Split::Test, photo.light_rotation_deg);
        Ok(PhotoCamera { name: photo.image.clone(), is_held_out, camera: camera?, light_rotation_deg })
    });
    described.collect()
}

/// The cameras that a `transforms*.json` states, without its photographs, in the order of its frames. The world is that of the
/// file, rotated if `up` is a direction. A path through a capture needs the direction that its import found ([`crate::WorldUp`]):
/// it is not +Z if the file's +Z is only the mean up direction of the cameras.
///
/// # Errors
/// [`CaptureError`] names the field at fault; `w,h` where the file states no size and `size` is none.
pub fn cameras_of_transforms(
    file: &str,
    bytes: &[u8],
    size: Option<(u32, u32)>,
    up: Up,
) -> Result<Vec<PhotoCamera>, CaptureError> {
    let turn = DMat4::from_quat(up.stated().rotation());
    let set = transforms::parse(file, bytes, &ImportLimits::default())?;
    let photos = set.frames.into_iter().map(|frame| PhotoEntry {
        image: frame.path,
        mask: None,
        pose: turn * frame.pose,
        lens: frame.lens,
        light_rotation_deg: frame.light_rotation_deg,
        light_group: None,
        stated_in: file.to_owned(),
        field: frame.field,
        split: Split::Train,
        truth: TruthFiles::default(),
    });
    photos.map(|photo| stated_camera(photo, size)).collect()
}

/// The cameras of a folder or archive with a COLMAP model, without its photographs, sorted by name. The world is that
/// of a capture with this model that was imported with the same `up`.
///
/// # Errors
/// [`CaptureError`] names the file and field at fault, or says that there is no model.
pub fn cameras_of_colmap(
    path: &Path,
    limits: &ImportLimits,
    up: impl Into<Up>,
) -> Result<Vec<PhotoCamera>, CaptureError> {
    let source = CaptureFiles::open(path, limits)?;
    let reason = "has no COLMAP model (cameras and images, .bin or .txt)".to_owned();
    let files = colmap::find(&source)
        .ok_or_else(|| CaptureError::File { file: source.label().to_owned(), reason })?;
    let mut photos = colmap::stated(&source, &files, up.into(), &mut Vec::new())?;
    photos.sort_by(|a, b| a.image.cmp(&b.image));
    photos.into_iter().map(|photo| stated_camera(photo, None)).collect()
}

/// The camera of a photograph that may be absent, at the size that its lens states, else at `size`.
fn stated_camera(photo: PhotoEntry, size: Option<(u32, u32)>) -> Result<PhotoCamera, CaptureError> {
    let pixels = |side: f64| (1.0..=1e6).contains(&side).then_some(side.round() as u32);
    let stated = photo.lens.size.and_then(|(width, height)| pixels(width).zip(pixels(height)));
    let size = stated.or(size).ok_or_else(|| {
        let reason = "no image size is stated, and no photograph has one";
        CaptureError::at_field(&photo.stated_in, format!("{}.w,h", photo.field), reason)
    })?;
    let camera = photos::camera_at(&photo, size)?;
    let light_rotation_deg = photo.light_rotation_deg;
    Ok(PhotoCamera { name: photo.image, is_held_out: photo.split == Split::Test, camera, light_rotation_deg })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use relume_spec::training::UpAxis;
    use serde_json::json;

    #[test]
    fn frames_are_rotated_by_a_stated_direction_only() {
        let pose = [[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 2.0], [0.0, 0.0, 1.0, 3.0], [0.0, 0.0, 0.0, 1.0]];
        let set = json!({ "w": 8, "h": 6, "fl_x": 9.0, "frames": [{ "file_path": "a", "transform_matrix": pose }] });
        let centre = |up: Up| {
            let cameras = cameras_of_transforms("frames", set.to_string().as_bytes(), None, up).unwrap();
            cameras[0].camera.centre()
        };
        let wanted = Up::from(UpAxis::Y).stated().rotation() * DVec3::new(1.0, 2.0, 3.0);
        assert!((centre(UpAxis::Y.into()) - wanted).length() < 1e-12 && (wanted.z - 2.0).abs() < 1e-12);
        for up in [Up::AUTO, Up::MEAN] {
            assert!((centre(up) - DVec3::new(1.0, 2.0, 3.0)).length() < 1e-12, "the world of the file");
        }
    }
}
