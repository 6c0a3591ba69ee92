//! Reading one image of a capture.

use crate::capture::{CaptureError, ImportOptions, Source};
use crate::formats::{ImageFileError, image_file};
use crate::scene::ImageRgba;

/// Decodes an image and reduces it as the options ask; also returns its stored size, pixels.
///
/// # Errors
/// [`CaptureError::OverLimit`] for too many pixels, [`CaptureError::Image`] when it cannot be decoded.
pub(super) fn load_image(
    source: &Source,
    path: &str,
    options: &ImportOptions,
) -> Result<(ImageRgba, (u32, u32)), CaptureError> {
    let bytes = source.read(path)?;
    let reduce = |stored| options.reduced_size(stored);
    image_file::decode_reduced(&bytes, options.limits.max_image_pixels, reduce).map_err(|error| match error {
        ImageFileError::TooManyPixels { .. } => {
            CaptureError::over_limit(path, "max_image_pixels", error.to_string())
        }
        other => CaptureError::image(path, other),
    })
}
