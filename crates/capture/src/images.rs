//! Reading one image of a capture.

use crate::formats::image_file::{self, Photograph};
use crate::formats::{ColourConversion, ImageFileError, SceneLight, exif_data};
use crate::{CaptureError, CaptureFiles, ImportOptions};
use relume_scene::{BitDepth, DisplayRange, ImageRgba};

/// Decodes a mask or map and reduces it as the options ask; also returns its stored size, pixels. Its values are those of
/// the file: a colour profile is not converted.
///
/// # Errors
/// [`CaptureError::OverLimit`] for too many pixels, [`CaptureError::Image`] when it cannot be decoded.
pub(super) fn load_image(
    source: &CaptureFiles,
    path: &str,
    options: &ImportOptions,
) -> Result<(ImageRgba, (u32, u32)), CaptureError> {
    let reduce = |stored| options.reduced_size(stored);
    image_file::decode_reduced(&source.read(path)?, options.limits.max_image_pixels, reduce)
        .map_err(|error| of_decoder(path, error))
}

/// Decodes a picture as display-encoded sRGB in [0, 1] and reduces it as the options ask.
///
/// # Errors
/// As [`load_image`].
pub(super) fn load_picture(
    source: &CaptureFiles,
    path: &str,
    options: &ImportOptions,
) -> Result<ImageRgba, CaptureError> {
    let Photograph { image, light, .. } = decode(path, &source.read(path)?, options)?;
    Ok(shown(image, light.range))
}

/// A decoded photograph.
#[derive(Debug)]
pub(super) struct Loaded {
    /// Pixels, reduced as the options ask.
    pub image: ImageRgba,
    /// Stored size, pixels.
    pub stored: (u32, u32),
    /// The least bit depth that holds the file's values.
    pub depth: BitDepth,
    /// The conversion of its colours to sRGB.
    pub colour: ColourConversion,
    /// Its brightness, if it contains linear light.
    pub light: SceneLight,
}

/// An image of colours in `range`, as a display shows it.
pub(super) fn shown(image: ImageRgba, range: DisplayRange) -> ImageRgba {
    match range {
        DisplayRange::Unit => image,
        DisplayRange::Extended => image.shown(),
    }
}

/// A photograph as display-encoded sRGB, whose lens is stated for `lens_size`. If only the image after EXIF rotation has the
/// aspect ratio of that size, the image and the returned size are rotated. Otherwise the poses refer to the pixels as
/// they are stored.
///
/// # Errors
/// As [`load_image`].
pub(super) fn load_photo(
    source: &CaptureFiles,
    path: &str,
    lens_size: Option<(f64, f64)>,
    options: &ImportOptions,
) -> Result<Loaded, CaptureError> {
    let bytes = source.read(path)?;
    let Photograph { image, stored, colour, light } = decode(path, &bytes, options)?;
    let depth = image_file::bit_depth(&bytes).map_err(|error| CaptureError::image(path, error))?;
    let (image, stored) = match turn(&bytes, stored, lens_size) {
        Some(turn) => (turned(&image, turn), (stored.1, stored.0)),
        None => (image, stored),
    };
    Ok(Loaded { image, stored, depth, colour, light })
}

/// Number of bytes at the start of a file that contain the header of most images.
pub(super) const HEAD: u64 = 256 << 10;

/// Stored width and height of an image. The whole file is read only if its first bytes do not contain the size.
///
/// # Errors
/// [`CaptureError::Image`] when the header cannot be read.
pub(super) fn dimensions(source: &CaptureFiles, path: &str) -> Result<(u32, u32), CaptureError> {
    if let Ok(size) = image_file::dimensions(&source.read_start(path, HEAD)?) {
        return Ok(size);
    }
    image_file::dimensions(&source.read(path)?).map_err(|error| CaptureError::image(path, error))
}

/// The size that [`load_photo`] returns, from the headers alone.
///
/// # Errors
/// As [`dimensions`].
pub(super) fn photo_size(
    source: &CaptureFiles,
    path: &str,
    lens_size: Option<(f64, f64)>,
) -> Result<(u32, u32), CaptureError> {
    let stored = dimensions(source, path)?;
    let is_turned =
        fits_only_turned(stored, lens_size) && turn(&source.read(path)?, stored, lens_size).is_some();
    Ok(if is_turned { (stored.1, stored.0) } else { stored })
}

fn decode(path: &str, bytes: &[u8], options: &ImportOptions) -> Result<Photograph, CaptureError> {
    let reduce = |stored| options.reduced_size(stored);
    image_file::decode_photograph(bytes, options.limits.max_image_pixels, reduce)
        .map_err(|error| of_decoder(path, error))
}

/// The error of a decoder with the path of the file.
fn of_decoder(path: &str, error: ImageFileError) -> CaptureError {
    match error {
        ImageFileError::TooManyPixels { .. } => {
            CaptureError::over_limit(path, "max_image_pixels", error.to_string())
        }
        other => CaptureError::image(path, other),
    }
}

/// The EXIF orientation, if it swaps the sides (5 to 8) and the lens is stated for an image with swapped sides.
fn turn(bytes: &[u8], stored: (u32, u32), lens_size: Option<(f64, f64)>) -> Option<u8> {
    if !fits_only_turned(stored, lens_size) {
        return None;
    }
    exif_data::read(bytes).orientation.filter(|turn| (5..=8).contains(turn))
}

/// Whether an image has the aspect ratio of the lens only with swapped sides.
fn fits_only_turned((width, height): (u32, u32), lens_size: Option<(f64, f64)>) -> bool {
    let Some((lens_width, lens_height)) = lens_size else { return false };
    // The size of the lens may be approximate.
    let fits = |width: u32, height: u32| {
        let ratio = lens_width / lens_height * f64::from(height) / f64::from(width);
        (ratio - 1.0).abs() <= 0.1
    };
    !fits(width, height) && fits(height, width)
}

/// The image as EXIF orientation `turn`, 5 to 8, shows it.
fn turned(image: &ImageRgba, turn: u8) -> ImageRgba {
    let (width, height) = (image.height, image.width);
    let last = (image.width as usize - 1, image.height as usize - 1);
    let stored = |x: usize, y: usize| match turn {
        5 => (y, x),
        6 => (y, last.1 - x),
        7 => (last.0 - y, last.1 - x),
        _ => (last.0 - y, x),
    };
    let pixel = |i: usize| {
        let (x, y) = stored(i % width as usize, i / width as usize);
        image.pixels[y * image.width as usize + x]
    };
    let pixels = (0..image.pixels.len()).map(pixel).collect();
    ImageRgba { width, height, pixels }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A JPEG header that states only an EXIF orientation.
    fn noting(orientation: u8) -> Vec<u8> {
        let tiff = [
            b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".as_slice(),
            &[orientation, 0, 0, 0, 0, 0, 0, 0],
        ];
        let tiff = tiff.concat();
        let length = ((tiff.len() + 8) as u16).to_be_bytes();
        [b"\xff\xd8\xff\xe1".as_slice(), &length, b"Exif\0\0", &tiff, b"\xff\xd9"].concat()
    }

    #[test]
    fn image_is_rotated_only_if_the_lens_fits_the_rotated_size() {
        let upright = Some((480.0, 640.0));
        assert_eq!(turn(&noting(6), (640, 480), upright), Some(6));
        assert_eq!(
            turn(&noting(6), (640, 480), Some((640.0, 480.0))),
            None,
            "poses refer to the stored pixels"
        );
        assert_eq!(turn(&noting(6), (640, 480), None), None);
        assert_eq!(turn(&noting(3), (640, 480), upright), None, "a half turn swaps no sides");
        assert_eq!(turn(b"", (640, 480), upright), None, "no orientation is stated");
        assert_eq!(turn(&noting(6), (640, 480), Some((100.0, 640.0))), None, "neither fits");
    }

    #[test]
    fn each_exif_orientation_gives_the_expected_image() {
        let pixel = |v: u8| [f32::from(v), 0.0, 0.0, 1.0];
        let image = ImageRgba { width: 3, height: 2, pixels: [1, 2, 3, 4, 5, 6].map(pixel).to_vec() };
        for (turn, wanted) in [
            (5, [1, 4, 2, 5, 3, 6]),
            (6, [4, 1, 5, 2, 6, 3]),
            (7, [6, 3, 5, 2, 4, 1]),
            (8, [3, 6, 2, 5, 1, 4]),
        ] {
            let shown = turned(&image, turn);
            assert_eq!((shown.width, shown.height), (2, 3));
            assert_eq!(shown.pixels, wanted.map(pixel), "{turn}");
        }
    }

    /// A file of `bytes` in a folder of its own.
    fn folder_of(bytes: &[u8]) -> (tempfile::TempDir, CaptureFiles) {
        let folder = tempfile::TempDir::new().unwrap();
        std::fs::write(folder.path().join("a"), bytes).unwrap();
        let files = CaptureFiles::open(folder.path(), &crate::ImportLimits::default()).unwrap();
        (folder, files)
    }

    #[test]
    fn image_size_needs_only_the_start_of_a_file_that_has_it_there() {
        use image::{ImageFormat, RgbImage};
        let noise = |i: u32| (i.wrapping_mul(2_654_435_761) >> 24) as u8;
        let image =
            RgbImage::from_fn(400, 300, |x, y| image::Rgb([0, 7, 99].map(|c| noise(x + 400 * y + c))));
        let encoded = |format: ImageFormat| {
            let mut bytes = std::io::Cursor::new(Vec::new());
            image.write_to(&mut bytes, format).unwrap();
            bytes.into_inner()
        };
        let (png, tiff) = (encoded(ImageFormat::Png), encoded(ImageFormat::Tiff));
        assert!(png.len() as u64 > HEAD + 4 && tiff.len() as u64 > HEAD);
        let (_folder, truncated) = folder_of(&png[..HEAD as usize + 4]);
        assert_eq!(dimensions(&truncated, "a").unwrap(), (400, 300));
        // The directory of this TIFF is at its end.
        let (_folder, whole) = folder_of(&tiff);
        assert!(image_file::dimensions(&whole.read_start("a", HEAD).unwrap()).is_err(), "the control");
        assert_eq!(dimensions(&whole, "a").unwrap(), (400, 300));
        let (_folder, none) = folder_of(b"no image");
        assert!(dimensions(&none, "a").unwrap_err().to_string().contains('a'));
    }
}
