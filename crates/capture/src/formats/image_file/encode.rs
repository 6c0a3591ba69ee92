//! Writes PNG and JPEG.

use image::{ExtendedColorType, ImageEncoder};
use jpeg_encoder::{ColorType, SamplingFactor};

use crate::formats::ImageFileError;
use relume_scene::{ImageRgba, srgb};

/// An 8-bit PNG of row-major pixels with C = 1 (grey), 3 (RGB) or 4 (RGBA, straight alpha) channels.
///
/// # Errors
/// [`ImageFileError::Encode`] if the pixels do not match the size, or for another number of channels.
pub fn encode_png<const C: usize>(
    width: u32,
    height: u32,
    pixels: &[[u8; C]],
) -> Result<Vec<u8>, ImageFileError> {
    use ExtendedColorType::{L8, Rgb8, Rgba8};
    write_png((width, height), pixels, [L8, Rgb8, Rgba8])
}

/// A 16-bit PNG, as [`encode_png`].
///
/// # Errors
/// As [`encode_png`].
pub fn encode_png16<const C: usize>(
    width: u32,
    height: u32,
    pixels: &[[u16; C]],
) -> Result<Vec<u8>, ImageFileError> {
    use ExtendedColorType::{L16, Rgb16, Rgba16};
    write_png((width, height), pixels, [L16, Rgb16, Rgba16])
}

fn write_png<T: bytemuck::NoUninit, const C: usize>(
    (width, height): (u32, u32),
    pixels: &[[T; C]],
    [grey, rgb, rgba]: [ExtendedColorType; 3],
) -> Result<Vec<u8>, ImageFileError> {
    let colour = match C {
        1 => grey,
        3 => rgb,
        4 => rgba,
        _ => return Err(ImageFileError::Encode(format!("a PNG cannot have {C} channels"))),
    };
    check_length(width, height, pixels.len())?;
    let mut out = Vec::new();
    image::codecs::png::PngEncoder::new(&mut out)
        .write_image(bytemuck::cast_slice(pixels.as_flattened()), width, height, colour)
        .map_err(|e| ImageFileError::Encode(e.to_string()))?;
    Ok(out)
}

/// A JPEG of row-major RGB pixels, `quality` 1 to 100.
///
/// # Errors
/// [`ImageFileError::Encode`] when the pixels do not fit the size, or a side is beyond JPEG's 65,535.
pub fn encode_jpeg(
    width: u32,
    height: u32,
    pixels: &[[u8; 3]],
    quality: u8,
) -> Result<Vec<u8>, ImageFileError> {
    check_length(width, height, pixels.len())?;
    let side = |side: u32| {
        u16::try_from(side)
            .map_err(|_| ImageFileError::Encode(format!("{side} pixels are more than a JPEG can have")))
    };
    let (width, height) = (side(width)?, side(height)?);
    let mut out = Vec::new();
    let mut encoder = jpeg_encoder::Encoder::new(&mut out, quality.clamp(1, 100));
    // 4:4:4: subsampled colour shows at the edges of saturated surfaces.
    encoder.set_sampling_factor(SamplingFactor::F_1_1);
    encoder
        .encode(pixels.as_flattened(), width, height, ColorType::Rgb)
        .map_err(|e| ImageFileError::Encode(e.to_string()))?;
    Ok(out)
}

fn check_length(width: u32, height: u32, pixels: usize) -> Result<(), ImageFileError> {
    if u64::from(width) * u64::from(height) == pixels as u64 && pixels > 0 {
        return Ok(());
    }
    Err(ImageFileError::Encode(format!("{pixels} pixels do not fill {width}x{height}")))
}

/// A photograph as an 8-bit RGBA PNG.
///
/// # Errors
/// As [`encode_png`].
pub fn encode_rgba(image: &ImageRgba) -> Result<Vec<u8>, ImageFileError> {
    let pixels: Vec<[u8; 4]> = image.pixels.iter().map(|p| p.map(srgb::to_u8)).collect();
    encode_png(image.width, image.height, &pixels)
}
