//! The camera that sees a rectangle of a photograph.

use std::path::Path;

use glam::DVec2;

use crate::grey_card::check_inside;
use crate::light_rotations::{NO_SUCH_PHOTO, SEVERAL_PHOTOS, is_named};
use crate::photos::{self, PhotoEntry};
use crate::{CaptureError, CaptureFiles, ImportLimits, Up, images, import};
use relume_scene::Camera;
use relume_spec::training::GreyCard;

/// Greatest width and height of the camera's picture, pixels: enough for a mean.
const MAX_SIDE: f64 = 64.0;

/// The pinhole camera whose picture is the part of a photograph in `patch`, at most 64 pixels wide and high. `patch` is in pixels of the
/// photograph as it is stored, with its lens distortion. The world is that of the capture at `path`, with the up direction `up`.
///
/// # Errors
/// [`CaptureError::Field`] with a name that fits no photograph or several, or with a rectangle that does not lie within it, otherwise as
/// [`crate::cameras`].
pub fn patch_camera(
    path: &Path,
    limits: &ImportLimits,
    up: impl Into<Up>,
    patch: &GreyCard,
) -> Result<Camera, CaptureError> {
    let refused = |field: &str, reason: &str| CaptureError::at_field(&patch.photo, field, reason.to_owned());
    let source = CaptureFiles::open(path, limits)?;
    let layout = import::read_layout(&source, up.into(), &mut Vec::new())?;
    let mut named = layout.photos.iter().filter(|photo| is_named(&photo.image, &patch.photo));
    let photo = named.next().ok_or_else(|| refused("patch.photo", NO_SUCH_PHOTO))?;
    if named.next().is_some() {
        return Err(refused("patch.photo", SEVERAL_PHOTOS));
    }
    let stored = images::photo_size(&source, &photo.image, photo.lens.approximate_size())?;
    check_inside(patch, stored, "patch")?;
    let (right, bottom) = patch.end();
    let corners = [(patch.x, patch.y), (right, patch.y), (patch.x, bottom), (right, bottom)];
    let corners = corners.map(|(x, y)| DVec2::new(f64::from(x), f64::from(y)));
    camera_of_part(photo, stored, corners, MAX_SIDE)?
        .ok_or_else(|| refused("patch", "the lens shows nothing there without its distortion"))
}

/// The camera of the smallest rectangle, without distortion, that contains `corners`, pixels of the photograph of `stored` pixels. Its picture
/// is at most `max_side` pixels wide and high. `None` if it is empty.
pub(super) fn camera_of_part(
    photo: &PhotoEntry,
    stored: (u32, u32),
    corners: [DVec2; 4],
    max_side: f64,
) -> Result<Option<Camera>, CaptureError> {
    let (straight, corners) = photos::straightened(photo, stored, corners)?;
    let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    for corner in corners {
        let Some(corner) = corner else { return Ok(None) };
        (low, high) = (low.min(corner), high.max(corner));
    }
    let size = high - low;
    if !(size.is_finite() && size.min_element() > 0.0) {
        return Ok(None);
    }
    let pixels = size.round().clamp(DVec2::ONE, DVec2::splat(max_side));
    let scale = pixels / size;
    Ok(Some(Camera {
        fx: straight.fx * scale.x,
        fy: straight.fy * scale.y,
        cx: (straight.cx - low.x) * scale.x,
        cy: (straight.cy - low.y) * scale.y,
        width: pixels.x as u32,
        height: pixels.y as u32,
        ..straight
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SyntheticOptions, synthetic, write_archive};

    fn patch(photo: &str, rectangle: [u32; 4]) -> GreyCard {
        let [x, y, width, height] = rectangle;
        GreyCard { photo: photo.to_owned(), x, y, width, height, reflectance: None }
    }

    #[test]
    fn patch_camera_sees_the_rectangle_of_the_photograph() {
        let options =
            SyntheticOptions { size: 40, train_views: 3, test_views: 1, paths: 4, ..Default::default() };
        let capture = synthetic(&options).unwrap();
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), write_archive(&capture).unwrap()).unwrap();
        let limits = ImportLimits::default();
        let of = |patch: &GreyCard| patch_camera(file.path(), &limits, Up::AUTO, patch);
        let part = of(&patch("train_001/rgba.png", [20, 4, 8, 6])).unwrap();
        assert_eq!((part.width, part.height), (8, 6));
        let cameras = crate::cameras(file.path(), &limits, Up::AUTO).unwrap();
        let whole = cameras.iter().find(|camera| camera.name == "train_001/rgba.png").unwrap().camera;
        for (x, y) in [(0, 0), (7, 5)] {
            let off = part.ray(x, y).normalize() - whole.ray(20 + x, 4 + y).normalize();
            assert!(off.length() < 1e-9, "{off}");
        }
        let control = part.ray(0, 0).normalize() - whole.ray(21, 4).normalize();
        assert!(control.length() > 1e-3, "the control: the next pixel");
        let large = of(&patch("train_001/rgba.png", [0, 0, 40, 40])).unwrap();
        assert_eq!((large.width, large.height), (40, 40));
        let field = |patch: &GreyCard| of(patch).unwrap_err().field().unwrap().to_owned();
        assert_eq!(field(&patch("train_009/rgba.png", [0, 0, 4, 4])), "patch.photo");
        assert_eq!(field(&patch("rgba.png", [0, 0, 4, 4])), "patch.photo", "several have this name");
        assert_eq!(field(&patch("train_001/rgba.png", [38, 0, 4, 4])), "patch.width");
        assert_eq!(field(&patch("train_001/rgba.png", [0, 38, 4, 4])), "patch.height");
    }
}
