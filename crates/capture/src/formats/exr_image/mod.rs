//! OpenEXR images as linear Rec.709 RGBA, for photographs and environment maps.

mod pixels;

use std::io::Cursor;

use exr::meta::attribute::Chromaticities;
use exr::meta::header::Header;
use exr::prelude::{IntegerBounds, MetaData, WritableImage};

use crate::formats::chromaticities::ToRec709;
use crate::formats::exr_channels;
use crate::formats::{ImageFileError, exr_window};

pub use exr::meta::attribute::EnvironmentMap;

/// Greatest number of decoded bytes of one file, all parts and channels together.
const MAX_DECODED_BYTES: u64 = 4 << 30;
/// Bytes of a pixel of [`ExrImage`].
const PIXEL_BYTES: u64 = 16;

/// An image read from a file.
#[derive(Debug, Clone, PartialEq)]
pub struct ExrImage {
    /// Width of the display window, pixels.
    pub width: u32,
    /// Height of the display window, pixels.
    pub height: u32,
    /// Row-major linear Rec.709 with alpha; absent alpha is 1. Pixels outside the data window are 0.
    pub pixels: Vec<[f32; 4]>,
    /// The layout of an environment map, if the attribute `envmap` states it.
    pub environment: Option<EnvironmentMap>,
    /// Conversions, and attributes that could not be used.
    pub notes: Vec<String>,
}

/// True when the bytes begin like an OpenEXR file.
pub fn is_exr(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01])
}

/// Width and height of the display window, from the header.
///
/// # Errors
/// [`ImageFileError::Damaged`] if the header cannot be read; [`ImageFileError::Unsupported`] if it names data that this
/// reader does not support, or has no colour.
pub fn dimensions(bytes: &[u8]) -> Result<(u32, u32), ImageFileError> {
    let meta = checked_header(bytes)?;
    let colour = exr_channels::find(&meta.headers)?;
    sides(display_window(&meta.headers[colour.part]))
}

/// Refuses an image of more than `limit` pixels by its header. The larger of data window and display window counts, because
/// [`decode`] allocates the pixels of both.
///
/// # Errors
/// [`ImageFileError::TooManyPixels`]; else as [`dimensions`].
pub(super) fn check_size(bytes: &[u8], limit: u64) -> Result<(), ImageFileError> {
    let meta = checked_header(bytes)?;
    let header = &meta.headers[exr_channels::find(&meta.headers)?.part];
    for window in [display_window(header), header.data_window()] {
        if area(window) > limit {
            let (width, height) = (window.size.x() as u64, window.size.y() as u64);
            return Err(ImageFileError::TooManyPixels { width, height, limit });
        }
    }
    Ok(())
}

/// Bytes that [`decode`] takes in addition to the file: the blocks of the part with the colour, and the pixels of the image.
/// From the header.
///
/// # Errors
/// As [`dimensions`].
pub fn decoded_bytes(bytes: &[u8]) -> Result<u64, ImageFileError> {
    let meta = checked_header(bytes)?;
    let colour = exr_channels::find(&meta.headers)?;
    let header = &meta.headers[colour.part];
    Ok(part_bytes(header).saturating_add(pixel_bytes(header)))
}

/// Bytes of the pixels of the data window, and of the display window if it differs.
fn pixel_bytes(header: &Header) -> u64 {
    let (data, display) = (header.data_window(), display_window(header));
    let placed = if display == data { 0 } else { area(display) };
    area(data).saturating_add(placed).saturating_mul(PIXEL_BYTES)
}

fn area(window: IntegerBounds) -> u64 {
    (window.size.x() as u64).saturating_mul(window.size.y() as u64)
}

fn part_bytes(header: &Header) -> u64 {
    area(header.data_window()).saturating_mul(4 * header.channels.list.len() as u64)
}

fn display_window(header: &Header) -> IntegerBounds {
    header.shared_attributes.display_window
}

fn sides(window: IntegerBounds) -> Result<(u32, u32), ImageFileError> {
    let side = |n: usize| u32::try_from(n).map_err(|_| ImageFileError::Damaged("is too large".into()));
    Ok((side(window.size.x())?, side(window.size.y())?))
}

/// The header, after checking that this reader supports it and that its size is within bounds.
fn checked_header(bytes: &[u8]) -> Result<MetaData, ImageFileError> {
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(damaged)?;
    let refuse = |reason: &str| Err(ImageFileError::Unsupported(reason.to_owned()));
    let mut decoded = 0u64;
    for header in &meta.headers {
        if header.deep {
            return refuse("has deep data, which Relume does not read; flatten it to one sample a pixel");
        }
        if header.channels.list.iter().any(|c| (c.sampling.x(), c.sampling.y()) != (1, 1)) {
            // Files with luminance and chroma are subsampled, and are named so.
            exr_channels::find(&meta.headers)?;
            return refuse(
                "has subsampled channels, which Relume does not read; save it without subsampling",
            );
        }
        decoded = decoded.saturating_add(part_bytes(header));
    }
    if decoded > MAX_DECODED_BYTES {
        return refuse("decodes to more than 4 GiB");
    }
    Ok(meta)
}

/// Reads the colour of a file: RGB of any part before luminance `Y`, a single layer of colour, placed in the display
/// window and converted to Rec.709 if the attribute `chromaticities` states other primaries.
///
/// # Errors
/// [`ImageFileError::Damaged`] when the file is corrupt; [`ImageFileError::Unsupported`] names the channels that were
/// found if there is no colour, deep and subsampled data, a data window outside the display window, and windows whose pixels
/// take more than 4 GiB.
pub fn decode(bytes: &[u8]) -> Result<ExrImage, ImageFileError> {
    let meta = checked_header(bytes)?;
    let colour = exr_channels::find(&meta.headers)?;
    let header = &meta.headers[colour.part];
    let (display, data) = (display_window(header), header.data_window());
    let (width, height) = sides(display)?;
    if pixel_bytes(header) > MAX_DECODED_BYTES {
        let reason = "has a data window and a display window that take more than 4 GiB";
        return Err(ImageFileError::Unsupported(reason.to_owned()));
    }
    let mut notes = Vec::new();
    let coverage = exr_window::coverage(data, display)?;
    let pixels = pixels::read(bytes, colour)?;
    let mut pixels = exr_window::placed(pixels, data, display);
    if coverage < 1.0 {
        notes.push(format!(
            "the data window covers {:.0} % of the display window; the rest is black",
            100.0 * coverage
        ));
    }
    if let Some(stated) = header.shared_attributes.chromaticities {
        notes.extend(convert(stated, &mut pixels));
    }
    let environment = header.own_attributes.environment_map;
    Ok(ExrImage { width, height, pixels, environment, notes })
}

/// As [`decode`], as `(width, height, pixels)`.
///
/// # Errors
/// As [`decode`].
pub fn decode_rgba(bytes: &[u8]) -> Result<(u32, u32, Vec<[f32; 4]>), ImageFileError> {
    decode(bytes).map(|image| (image.width, image.height, image.pixels))
}

/// Converts colours from the stated primaries to Rec.709. Returns a note if the colours changed or the primaries are
/// unusable.
fn convert(stated: Chromaticities, pixels: &mut [[f32; 4]]) -> Option<String> {
    let xy = [stated.red, stated.green, stated.blue, stated.white].map(|v| [v.x(), v.y()]);
    match ToRec709::of(xy) {
        Ok(None) => None,
        Ok(Some(conversion)) => {
            for [r, g, b, _] in pixels {
                [*r, *g, *b] = conversion.apply([*r, *g, *b]);
            }
            Some(format!(
                "the colours were converted from {} to Rec.709 (attribute chromaticities)",
                conversion.name
            ))
        }
        Err(_) => {
            Some("the attribute chromaticities is unusable; the colours were taken as Rec.709".to_owned())
        }
    }
}

/// A single-part RGB EXR of f32 values, ZIP-compressed.
///
/// # Errors
/// [`ImageFileError::Encode`] when the pixels do not fit the size.
pub fn encode_rgb(width: usize, height: usize, pixels: &[[f32; 3]]) -> Result<Vec<u8>, ImageFileError> {
    if pixels.is_empty() || pixels.len() != width * height {
        return Err(ImageFileError::Encode(format!("{} pixels do not fill {width}x{height}", pixels.len())));
    }
    let pixel = |p: exr::math::Vec2<usize>| {
        let [r, g, b] = pixels[p.y() * width + p.x()];
        (r, g, b)
    };
    let mut out = Cursor::new(Vec::new());
    exr::prelude::Image::from_channels((width, height), exr::prelude::SpecificChannels::rgb(pixel))
        .write()
        .to_buffered(&mut out)
        .map_err(|e| ImageFileError::Encode(e.to_string()))?;
    Ok(out.into_inner())
}

fn damaged(error: exr::error::Error) -> ImageFileError {
    ImageFileError::Damaged(error.to_string())
}

#[cfg(test)]
mod tests;
