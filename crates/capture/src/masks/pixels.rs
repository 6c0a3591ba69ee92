//! The values of masks.

use super::MaskFile;
use crate::formats::image_file;
use crate::images::load_image;
use crate::{CaptureError, CaptureFiles, ImportOptions};
use relume_scene::ImageRgba;

/// Largest relative difference of the aspect ratios of a mask and its photograph.
const ASPECT_TOLERANCE: f64 = 0.02;
/// Masks whose largest value is below this contain labels (0, 1, 2) instead of 0 and the largest integer.
const LARGEST_LABEL: f32 = 0.05;

/// Multiplies the alpha of a photograph by its mask. `stored` is the stored size of the photograph, pixels.
///
/// # Errors
/// [`CaptureError::Image`] when the mask has another aspect ratio than the photograph or cannot be decoded.
pub(crate) fn apply(
    source: &CaptureFiles,
    mask: &MaskFile,
    stored: (u32, u32),
    image: &mut ImageRgba,
    options: &ImportOptions,
) -> Result<(), CaptureError> {
    let (decoded, size) = load_image(source, &mask.path, options)?;
    let aspect = |(width, height): (u32, u32)| f64::from(width) / f64::from(height.max(1));
    if !((aspect(size) / aspect(stored) - 1.0).abs() <= ASPECT_TOLERANCE) {
        return Err(CaptureError::Image {
            file: mask.path.clone(),
            reason: format!(
                "has {} x {} pixels, its photograph {} x {}; a mask must have the aspect ratio of its photograph",
                size.0, size.1, stored.0, stored.1
            ),
        });
    }
    let decoded = match (decoded.width, decoded.height) == (image.width, image.height) {
        true => decoded,
        false => decoded.resized(image.width, image.height),
    };
    let values = values(&decoded, mask.hides);
    image.pixels.iter_mut().zip(values).for_each(|(pixel, value)| pixel[3] *= value);
    Ok(())
}

/// The share of the object in each pixel of a mask, 0 to 1.
fn values(mask: &ImageRgba, hides: bool) -> Vec<f32> {
    let has_alpha = mask.pixels.iter().any(|pixel| pixel[3] < 0.99);
    let raw = |pixel: &[f32; 4]| match has_alpha {
        true => pixel[3],
        false => pixel[0].max(pixel[1]).max(pixel[2]),
    };
    let largest = mask.pixels.iter().map(raw).fold(0.0, f32::max);
    let scale = match largest {
        _ if largest > LARGEST_LABEL || has_alpha => 1.0,
        _ if largest < 0.5 / 255.0 => 65_535.0,
        _ => 255.0,
    };
    let value = |pixel: &[f32; 4]| {
        let value = (raw(pixel) * scale).min(1.0);
        if hides { 1.0 - value } else { value }
    };
    mask.pixels.iter().map(value).collect()
}

/// A mask as an 8-bit grey PNG whose white pixels mark the object, for programs that know no other form. A PNG of this form
/// is returned unchanged.
///
/// # Errors
/// [`CaptureError::Image`] when the mask cannot be decoded.
pub(crate) fn as_png(mask: &MaskFile, bytes: Vec<u8>) -> Result<Vec<u8>, CaptureError> {
    let named = |error| CaptureError::image(&mask.path, error);
    let image = image_file::decode(&bytes, image_file::DEFAULT_MAX_PIXELS).map_err(named)?;
    let values = values(&image, mask.hides);
    let is_plain = image.pixels.iter().zip(&values).all(|(pixel, value)| pixel[0] == *value);
    if is_plain && bytes.starts_with(b"\x89PNG") {
        return Ok(bytes);
    }
    let grey: Vec<[u8; 1]> = values.iter().map(|value| [(value * 255.0).round() as u8]).collect();
    image_file::encode_png(image.width, image.height, &grey).map_err(named)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(pixels: &[[f32; 4]]) -> ImageRgba {
        ImageRgba { width: pixels.len() as u32, height: 1, pixels: pixels.to_vec() }
    }

    fn grey(values: &[f32]) -> ImageRgba {
        mask(&values.iter().map(|v| [*v, *v, *v, 1.0]).collect::<Vec<_>>())
    }

    #[test]
    fn labels_alpha_and_hiding_masks_give_the_same_values() {
        let expected = [0.0, 1.0, 1.0];
        let label = 1.0 / 255.0;
        for (image, hides) in [
            (grey(&[0.0, 1.0, 1.0]), false),
            (grey(&[0.0, label, 2.0 * label]), false),
            (grey(&[0.0, 1.0 / 65_535.0, 1.0 / 65_535.0]), false),
            (grey(&[1.0, 0.0, 0.0]), true),
            (mask(&[[0.4, 0.2, 0.1, 0.0], [0.1, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0]]), false),
            (mask(&[[0.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 1.0], [1.0, 0.0, 0.0, 1.0]]), false),
        ] {
            assert_eq!(values(&image, hides), expected, "{image:?}");
        }
        assert_eq!(values(&grey(&[0.0, 0.5, 1.0]), false), [0.0, 0.5, 1.0], "soft edges stay");
        assert_eq!(values(&grey(&[0.0; 3]), false), [0.0; 3], "an empty mask stays empty");
    }

    #[test]
    fn masks_are_rewritten_only_if_others_would_misread_them() {
        let png = image_file::encode_png(2, 1, &[[0u8], [255]]).unwrap();
        let labels = image_file::encode_png(2, 1, &[[0u8], [1]]).unwrap();
        let file = |hides| MaskFile { path: "masks/a.png".to_owned(), hides };
        assert_eq!(as_png(&file(false), png.clone()).unwrap(), png);
        assert_eq!(as_png(&file(false), labels).unwrap(), png);
        let inverted = image_file::encode_png(2, 1, &[[255u8], [0]]).unwrap();
        assert_eq!(as_png(&file(true), png).unwrap(), inverted);
    }
}
