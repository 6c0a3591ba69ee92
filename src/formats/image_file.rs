//! Photographs: PNG, JPEG, WebP and EXR bytes to pixels, and pixels to PNG and JPEG.
//!
//! The format is detected from the content, never from a file's name.

use std::io::Cursor;

use image::{DynamicImage, ExtendedColorType, ImageDecoder, ImageEncoder, ImageFormat, ImageReader};

use crate::formats::{ImageFileError, exr_image, srgb};
use crate::scene::ImageRgba;

/// Most pixels of one image unless a caller says otherwise.
pub const DEFAULT_MAX_PIXELS: u64 = 64 << 20;

/// Width and height from the header, nothing decoded.
///
/// # Errors
/// [`ImageFileError`] when the kind is unknown or the header unreadable.
pub fn dimensions(bytes: &[u8]) -> Result<(u32, u32), ImageFileError> {
    if exr_image::is_exr(bytes) {
        return exr_image::dimensions(bytes);
    }
    // The PNG reader needs pixel data before it returns a size, which is in the header.
    if let (true, Some(&[a, b, c, d, e, f, g, h])) = (is_png(bytes), bytes.get(16..24)) {
        return Ok((u32::from_be_bytes([a, b, c, d]), u32::from_be_bytes([e, f, g, h])));
    }
    let reader = ImageReader::with_format(Cursor::new(bytes), kind(bytes)?);
    reader.into_dimensions().map_err(damaged)
}

/// A photograph as display-referred RGBA with straight alpha. EXR holds linear light, which is encoded with
/// the sRGB curve and clamped; every other kind is taken as sRGB. Images without alpha are opaque.
///
/// # Errors
/// [`ImageFileError`]; more than `max_pixels` is refused before anything is decoded.
pub fn decode(bytes: &[u8], max_pixels: u64) -> Result<ImageRgba, ImageFileError> {
    check_size(bytes, max_pixels)?;
    if exr_image::is_exr(bytes) {
        let (width, height, linear) = exr_image::decode_rgba(bytes)?;
        let display = |p: [f32; 4]| [srgb::encode(p[0]), srgb::encode(p[1]), srgb::encode(p[2]), p[3]];
        let pixels = linear.into_iter().map(|p| display(straightened(p))).collect();
        return Ok(ImageRgba { width, height, pixels });
    }
    let image = decode_dynamic(bytes)?;
    let (width, height) = (image.width(), image.height());
    let pixels = match image {
        DynamicImage::ImageRgb8(i) => i.pixels().map(|p| rgba8([p[0], p[1], p[2], 255])).collect(),
        DynamicImage::ImageRgba8(i) => i.pixels().map(|p| rgba8(p.0)).collect(),
        other => other.into_rgba32f().pixels().map(|p| p.0).collect(),
    };
    Ok(ImageRgba { width, height, pixels })
}

fn rgba8(p: [u8; 4]) -> [f32; 4] {
    p.map(|v| f32::from(v) / 255.0)
}

/// EXR colour is premultiplied by convention. Alpha above 1 becomes 1; negative alpha and NaN become 0.
fn straightened([r, g, b, a]: [f32; 4]) -> [f32; 4] {
    let a = if a > 0.0 { a.min(1.0) } else { 0.0 };
    let divisor = if a > 0.0 { a } else { 1.0 };
    [r / divisor, g / divisor, b / divisor, a]
}

fn check_size(bytes: &[u8], limit: u64) -> Result<(), ImageFileError> {
    let (width, height) = dimensions(bytes)?;
    let (width, height) = (u64::from(width), u64::from(height));
    if width * height > limit {
        return Err(ImageFileError::TooManyPixels { width, height, limit });
    }
    Ok(())
}

fn decode_dynamic(bytes: &[u8]) -> Result<DynamicImage, ImageFileError> {
    let mut reader = ImageReader::with_format(Cursor::new(bytes), kind(bytes)?);
    reader.no_limits();
    let decoder = reader.into_decoder().map_err(damaged)?;
    if decoder.total_bytes() > 1 << 32 {
        return Err(ImageFileError::Damaged("it decodes to more than 4 GiB".into()));
    }
    DynamicImage::from_decoder(decoder).map_err(damaged)
}

fn kind(bytes: &[u8]) -> Result<ImageFormat, ImageFileError> {
    if bytes.is_empty() {
        return Err(ImageFileError::Empty);
    }
    match image::guess_format(bytes) {
        Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::WebP)) => Ok(format),
        _ => Err(ImageFileError::UnknownKind(format!("{:?}", String::from_utf8_lossy(first(bytes))))),
    }
}

fn first(bytes: &[u8]) -> &[u8] {
    &bytes[..bytes.len().min(8)]
}

fn is_png(bytes: &[u8]) -> bool {
    bytes.starts_with(b"\x89PNG\r\n\x1a\n")
}

fn damaged(error: image::ImageError) -> ImageFileError {
    ImageFileError::Damaged(error.to_string())
}

/// An 8-bit PNG of row-major pixels with C = 1 (grey), 3 (RGB) or 4 (RGBA, straight alpha) channels.
///
/// # Errors
/// [`ImageFileError::Encode`] when the pixels do not fit the size or the channel count is another.
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
    let mut out = Vec::new();
    let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut out, quality.clamp(1, 100));
    encoder
        .write_image(pixels.as_flattened(), width, height, ExtendedColorType::Rgb8)
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

#[cfg(test)]
mod tests {
    use super::*;

    fn gradient() -> ImageRgba {
        let pixels =
            (0..12).map(|i| [i as f32 / 11.0, 0.25, 1.0 - i as f32 / 11.0, (i % 3) as f32 / 2.0]).collect();
        ImageRgba { width: 4, height: 3, pixels }
    }

    #[test]
    fn eight_bit_png_round_trips_to_half_a_level() {
        let image = gradient();
        let back = decode(&encode_rgba(&image).unwrap(), 12).unwrap();
        for (a, b) in image.pixels.as_flattened().iter().zip(back.pixels.as_flattened()) {
            assert!((a - b).abs() <= 0.5 / 255.0 + 1e-6, "{a} {b}");
        }
    }

    #[test]
    fn sixteen_bit_grey_keeps_sixteen_bits() {
        let bytes = encode_png16(2, 1, &[[1u16], [40_001]]).unwrap();
        let back = decode(&bytes, 2).unwrap();
        assert_eq!(back.pixels[0][0], 1.0 / 65535.0);
        assert!((back.pixels[1][1] - 40_001.0 / 65535.0).abs() < 1e-7);
    }

    #[test]
    fn jpeg_and_webp_are_told_by_content() {
        let jpeg = encode_jpeg(16, 16, &[[200, 100, 50]; 256], 95).unwrap();
        let p = decode(&jpeg, 256).unwrap().pixels[17];
        assert!((p[0] - 200.0 / 255.0).abs() < 0.02 && p[3] == 1.0, "{p:?}");
        let mut webp = Vec::new();
        image::codecs::webp::WebPEncoder::new_lossless(&mut webp)
            .write_image(&[10, 20, 30, 40], 1, 1, ExtendedColorType::Rgba8)
            .unwrap();
        assert_eq!(decode(&webp, 1).unwrap().pixels[0], rgba8([10, 20, 30, 40]));
    }

    #[test]
    fn a_huge_header_is_refused_without_its_pixels() {
        let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR".to_vec();
        png.extend([0, 0, 0x4e, 0x20, 0, 0, 0x4e, 0x20, 8, 6, 0, 0, 0, 0, 0, 0, 0]);
        let error = decode(&png, DEFAULT_MAX_PIXELS).unwrap_err();
        assert!(matches!(error, ImageFileError::TooManyPixels { width: 20_000, height: 20_000, .. }));
    }

    #[test]
    fn empty_textual_and_cut_files_say_what_they_are() {
        assert_eq!(decode(b"", 1).unwrap_err(), ImageFileError::Empty);
        let text = decode(b"hello, I am a picture", 1).unwrap_err();
        assert!(text.to_string().contains("hello"), "{text}");
        let whole = encode_rgba(&gradient()).unwrap();
        let cut = decode(&whole[..whole.len() - 30], 12).unwrap_err();
        assert!(matches!(cut, ImageFileError::Damaged(_)), "{cut}");
    }

    #[test]
    fn wrong_lengths_are_not_encoded() {
        assert!(encode_png(2, 2, &[[0u8; 3]; 3]).is_err());
        assert!(encode_png(1, 1, &[[0u8; 2]; 1]).is_err());
        assert!(encode_jpeg(0, 0, &[], 90).is_err());
    }
}
