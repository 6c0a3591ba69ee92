//! The kind, size and bit depth of an image file, from its header.

use std::io::Cursor;

use image::{ColorType as ColourKind, ImageDecoder, ImageFormat, ImageReader};

use crate::formats::{ImageFileError, exr_image, foreign, heif, raw_photo, recognise_foreign};
use relume_scene::BitDepth;

/// Width and height from the header, without decoding.
///
/// # Errors
/// [`ImageFileError`] when the kind is unknown or the header unreadable.
pub fn dimensions(bytes: &[u8]) -> Result<(u32, u32), ImageFileError> {
    if exr_image::is_exr(bytes) {
        return exr_image::dimensions(bytes);
    }
    if heif::is_heif(bytes) {
        return Ok(heif::header(bytes)?.size);
    }
    // The PNG reader requires pixel data before it returns the size, so the size is read from the header directly.
    if let (true, Some(&[a, b, c, d, e, f, g, h])) = (is_png(bytes), bytes.get(16..24)) {
        return Ok((u32::from_be_bytes([a, b, c, d]), u32::from_be_bytes([e, f, g, h])));
    }
    let reader = ImageReader::with_format(Cursor::new(bytes), kind(bytes)?);
    reader.into_dimensions().map_err(damaged)
}

/// The least bit depth that holds the values of an image file, from its header: 8 for 8 bits a channel, else 16.
///
/// # Errors
/// As [`dimensions`].
pub fn bit_depth(bytes: &[u8]) -> Result<BitDepth, ImageFileError> {
    if exr_image::is_exr(bytes) {
        return Ok(BitDepth::Sixteen);
    }
    if heif::is_heif(bytes) {
        return Ok(if heif::header(bytes)?.bits > 8 { BitDepth::Sixteen } else { BitDepth::Eight });
    }
    let mut reader = ImageReader::with_format(Cursor::new(bytes), kind(bytes)?);
    reader.no_limits();
    let colour = reader.into_decoder().map_err(damaged)?.color_type();
    let is_eight = matches!(colour, ColourKind::L8 | ColourKind::La8 | ColourKind::Rgb8 | ColourKind::Rgba8);
    Ok(if is_eight { BitDepth::Eight } else { BitDepth::Sixteen })
}

/// Whether an image file has a single colour channel, from its header; false if the header cannot be read.
pub(crate) fn is_grey(bytes: &[u8]) -> bool {
    let Ok(format) = kind(bytes) else { return false };
    let colour = ImageReader::with_format(Cursor::new(bytes), format).into_decoder().map(|d| d.color_type());
    colour.is_ok_and(|colour| {
        matches!(colour, ColourKind::L8 | ColourKind::La8 | ColourKind::L16 | ColourKind::La16)
    })
}

/// Refuses an image of more than `limit` pixels by its header.
pub(super) fn check_size(bytes: &[u8], limit: u64) -> Result<(), ImageFileError> {
    if exr_image::is_exr(bytes) {
        return exr_image::check_size(bytes, limit);
    }
    let (width, height) = dimensions(bytes)?;
    let (width, height) = (u64::from(width), u64::from(height));
    if width * height > limit {
        return Err(ImageFileError::TooManyPixels { width, height, limit });
    }
    Ok(())
}

/// The kind of a file that the decoders of the crate `image` read.
pub(super) fn kind(bytes: &[u8]) -> Result<ImageFormat, ImageFileError> {
    if bytes.is_empty() {
        return Err(ImageFileError::Empty);
    }
    if let Some(kind) = raw_photo::recognise(bytes) {
        return Err(ImageFileError::CameraRaw(kind));
    }
    if let Some(what) = recognise_foreign(bytes).or_else(|| foreign::recognise_image(bytes)) {
        return Err(ImageFileError::Foreign(what));
    }
    match image::guess_format(bytes) {
        Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::WebP | ImageFormat::Tiff)) => {
            Ok(format)
        }
        _ => Err(ImageFileError::UnknownKind(format!("{:?}", String::from_utf8_lossy(first(bytes))))),
    }
}

fn first(bytes: &[u8]) -> &[u8] {
    &bytes[..bytes.len().min(8)]
}

fn is_png(bytes: &[u8]) -> bool {
    bytes.starts_with(b"\x89PNG\r\n\x1a\n")
}

pub(super) fn damaged(error: image::ImageError) -> ImageFileError {
    ImageFileError::Damaged(error.to_string())
}
