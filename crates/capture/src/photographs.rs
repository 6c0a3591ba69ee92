//! Access to single photographs of a capture.

use std::path::Path;

use crate::cameras::{self, PhotoCamera};
use crate::photos::{self, PhotoEntry};
use crate::{CaptureError, CaptureFiles, ImportLimits, ImportOptions, Up, images, import};
use relume_scene::ImageRgba;

/// Upper bound on the bytes of a pixel of a decoded file: floats with alpha.
const STORED_PIXEL: u64 = 16;
/// Bytes of a pixel of a picture: floats, held twice while distortion is removed, and the encoded file.
const PICTURE_PIXEL: u64 = 40;

/// The photographs of a capture.
#[derive(Debug)]
pub struct CapturePhotos {
    source: CaptureFiles,
    photos: Vec<PhotoEntry>,
}

/// Options of [`CapturePhotos::picture`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub struct PictureOptions {
    /// Greatest width, pixels; `None` keeps the stored width. A picture is never enlarged.
    pub width: Option<u32>,
    /// Whether the lens distortion is removed, as in training: the picture is that of a pinhole camera.
    pub undistorted: bool,
}

impl CapturePhotos {
    /// Opens a folder, zip, tar or tar.gz with a supported layout. No photograph is decoded.
    ///
    /// # Errors
    /// [`CaptureError`] names the file and field at fault.
    pub fn open(path: &Path, limits: &ImportLimits) -> Result<Self, CaptureError> {
        let source = CaptureFiles::open(path, limits)?;
        let photos = import::read_layout(&source, Up::AUTO, &mut Vec::new())?.photos;
        Ok(Self { source, photos })
    }

    /// The cameras of the photographs, in the order in which the layout names them: those of [`crate::cameras`].
    ///
    /// # Errors
    /// [`CaptureError`] names the file and field at fault.
    pub fn cameras(&self, up: impl Into<Up>) -> Result<Vec<PhotoCamera>, CaptureError> {
        let up = up.into();
        if up == Up::AUTO {
            return cameras::of_photos(&self.source, &self.photos);
        }
        let layout = import::read_layout(&self.source, up, &mut Vec::new())?;
        cameras::of_photos(&self.source, &layout.photos)
    }

    /// Whether `name` is a photograph of the capture. Other files of the archive are not photographs.
    pub fn contains(&self, name: &str) -> bool {
        self.photos.iter().any(|photo| photo.image == name)
    }

    /// Upper bound on the bytes of memory that [`Self::picture`] takes, from the photograph's header.
    ///
    /// # Errors
    /// As [`Self::picture`].
    pub fn picture_bytes(&self, name: &str, options: &PictureOptions) -> Result<u64, CaptureError> {
        let photo = self.find(name)?;
        let stored = images::photo_size(&self.source, name, photo.lens.approximate_size())?;
        let shown = reduction(options, stored).reduced_size(stored);
        let pixels = |(width, height): (u32, u32)| u64::from(width) * u64::from(height);
        Ok(pixels(stored) * STORED_PIXEL + pixels(shown) * PICTURE_PIXEL)
    }

    /// A photograph in the orientation of its camera, without its mask file.
    ///
    /// # Errors
    /// [`CaptureError::File`] if the capture has no photograph of this name; else names the unusable file or field.
    pub fn picture(&self, name: &str, options: &PictureOptions) -> Result<ImageRgba, CaptureError> {
        let photo = self.find(name)?;
        let stored = images::photo_size(&self.source, name, photo.lens.approximate_size())?;
        let limits = *self.source.limits();
        let reduced = ImportOptions { limits, ..reduction(options, stored) };
        photos::picture(&self.source, photo, &reduced, options.undistorted)
    }

    fn find(&self, name: &str) -> Result<&PhotoEntry, CaptureError> {
        let missing = || CaptureError::File { file: name.to_owned(), reason: "is missing".to_owned() };
        self.photos.iter().find(|photo| photo.image == name).ok_or_else(missing)
    }
}

/// Import options that reduce a photograph of `stored` pixels to the requested width.
fn reduction(options: &PictureOptions, (width, height): (u32, u32)) -> ImportOptions {
    let longest = |wanted: u32| {
        let height = f64::from(height) * f64::from(wanted) / f64::from(width.max(1));
        wanted.max(height.round() as u32)
    };
    let max_side = options.width.filter(|wanted| *wanted < width).map(longest);
    ImportOptions { max_side, ..ImportOptions::default() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn image_has_the_requested_width_and_is_never_enlarged() {
        let size = |width, stored| {
            let options = PictureOptions { width, undistorted: false };
            reduction(&options, stored).reduced_size(stored)
        };
        assert_eq!(size(Some(100), (400, 300)), (100, 75));
        assert_eq!(size(Some(100), (300, 400)), (100, 133), "upright");
        assert_eq!(size(Some(64), (3024, 4032)), (64, 85));
        assert_eq!(size(Some(1000), (400, 300)), (400, 300));
        assert_eq!(size(None, (400, 300)), (400, 300));
        for width in 16..=200 {
            assert_eq!(size(Some(width), (3000, 4001)).0, width);
        }
    }
}
