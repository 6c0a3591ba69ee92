//! Image files: decodes PNG, JPEG, WebP, TIFF and EXR, encodes PNG and JPEG.
//!
//! The format is detected from the content, never from a file's name.

use std::io::Cursor;

use image::{
    ColorType as ColourKind, DynamicImage, ExtendedColorType, ImageDecoder, ImageEncoder, ImageFormat,
    ImageReader,
};
use jpeg_encoder::{ColorType, SamplingFactor};

use crate::formats::{ImageFileError, exr_image, recognise_foreign};
use relume_scene::{BitDepth, ImageRgba, srgb};

/// Default limit on the pixels of one image.
pub const DEFAULT_MAX_PIXELS: u64 = 134_000_000;

/// Width and height from the header, without decoding.
///
/// # Errors
/// [`ImageFileError`] when the kind is unknown or the header unreadable.
pub fn dimensions(bytes: &[u8]) -> Result<(u32, u32), ImageFileError> {
    if exr_image::is_exr(bytes) {
        return exr_image::dimensions(bytes);
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
    let mut reader = ImageReader::with_format(Cursor::new(bytes), kind(bytes)?);
    reader.no_limits();
    let colour = reader.into_decoder().map_err(damaged)?.color_type();
    let is_eight = matches!(colour, ColourKind::L8 | ColourKind::La8 | ColourKind::Rgb8 | ColourKind::Rgba8);
    Ok(if is_eight { BitDepth::Eight } else { BitDepth::Sixteen })
}

/// A photograph as display-referred RGBA with straight alpha. EXR and float TIFF contain linear light, which is
/// encoded with the sRGB curve and clamped; all other files are taken as sRGB. Images without alpha are opaque.
///
/// # Errors
/// [`ImageFileError`]; more than `max_pixels` is refused before anything is decoded.
pub fn decode(bytes: &[u8], max_pixels: u64) -> Result<ImageRgba, ImageFileError> {
    Ok(decode_reduced(bytes, max_pixels, |stored| stored)?.0)
}

/// [`decode`], reduced to the size that `reduce` gives for the stored size, which is also returned. Besides the
/// file's decoded pixels in their own type it takes memory only for the reduced image.
///
/// # Errors
/// As [`decode`].
pub fn decode_reduced(
    bytes: &[u8],
    max_pixels: u64,
    reduce: impl Fn((u32, u32)) -> (u32, u32),
) -> Result<(ImageRgba, (u32, u32)), ImageFileError> {
    check_size(bytes, max_pixels)?;
    if exr_image::is_exr(bytes) {
        let (width, height, linear) = exr_image::decode_rgba(bytes)?;
        let stored = (width, height);
        let pixel = |i: usize| displayed(straightened(linear[i]));
        return Ok((ImageRgba::reduced(stored, reduce(stored), pixel), stored));
    }
    let image = decode_dynamic(bytes)?;
    let stored = (image.width(), image.height());
    Ok((reduced(&image, stored, reduce(stored)), stored))
}

/// `image` resized from `stored` to `size`.
fn reduced(image: &DynamicImage, stored: (u32, u32), size: (u32, u32)) -> ImageRgba {
    use DynamicImage as D;
    fn unit8(v: u8) -> f32 {
        f32::from(v) / 255.0
    }
    fn unit16(v: u16) -> f32 {
        f32::from(v) / 65535.0
    }
    /// Row-major samples, `C` a pixel: grey, grey and alpha, RGB or RGBA.
    fn pixel<T: Copy, const C: usize>(samples: &[T], i: usize, unit: impl Fn(T) -> f32) -> [f32; 4] {
        let at = |k: usize| unit(samples[C * i + k]);
        match C {
            1 => [at(0), at(0), at(0), 1.0],
            2 => [at(0), at(0), at(0), at(1)],
            3 => [at(0), at(1), at(2), 1.0],
            _ => [at(0), at(1), at(2), at(3)],
        }
    }
    let of = |pixel: &dyn Fn(usize) -> [f32; 4]| ImageRgba::reduced(stored, size, pixel);
    match image {
        D::ImageRgb8(image) => ImageRgba::reduced(stored, size, |i| pixel::<_, 3>(image, i, unit8)),
        D::ImageRgba8(image) => ImageRgba::reduced(stored, size, |i| pixel::<_, 4>(image, i, unit8)),
        D::ImageLuma8(image) => of(&|i| pixel::<_, 1>(image, i, unit8)),
        D::ImageLumaA8(image) => of(&|i| pixel::<_, 2>(image, i, unit8)),
        D::ImageLuma16(image) => of(&|i| pixel::<_, 1>(image, i, unit16)),
        D::ImageLumaA16(image) => of(&|i| pixel::<_, 2>(image, i, unit16)),
        D::ImageRgb16(image) => of(&|i| pixel::<_, 3>(image, i, unit16)),
        D::ImageRgba16(image) => of(&|i| pixel::<_, 4>(image, i, unit16)),
        D::ImageRgb32F(image) => of(&|i| displayed(pixel::<_, 3>(image, i, |v| v))),
        D::ImageRgba32F(image) => of(&|i| displayed(pixel::<_, 4>(image, i, |v| v))),
        other => {
            let image = other.to_rgba32f();
            of(&|i| pixel::<_, 4>(&image, i, |v| v))
        }
    }
}

/// Linear light encoded for display; NaN becomes 0.
fn displayed([r, g, b, a]: [f32; 4]) -> [f32; 4] {
    let alpha = if a > 0.0 { a.min(1.0) } else { 0.0 };
    [srgb::encode(r), srgb::encode(g), srgb::encode(b), alpha]
}

/// Straight alpha from premultiplied, which EXR uses by convention. Alpha above 1 becomes 1; negative alpha and NaN
/// become 0.
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
        Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::WebP | ImageFormat::Tiff)) => {
            Ok(format)
        }
        _ if let Some(what) = recognise_foreign(bytes) => Err(ImageFileError::Foreign(what)),
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
    fn sixteen_bit_grey_png_keeps_its_precision() {
        let bytes = encode_png16(2, 1, &[[1u16], [40_001]]).unwrap();
        let back = decode(&bytes, 2).unwrap();
        assert_eq!(back.pixels[0][0], 1.0 / 65535.0);
        assert!((back.pixels[1][1] - 40_001.0 / 65535.0).abs() < 1e-7);
    }

    #[test]
    fn bit_depth_is_read_from_the_file() {
        let eight = encode_png(1, 1, &[[1u8, 2, 3]]).unwrap();
        let sixteen = encode_png16(1, 1, &[[1u16, 2, 3]]).unwrap();
        let floats = tiff(1, 1, &[0; 12], ExtendedColorType::Rgb32F);
        let jpeg = encode_jpeg(8, 8, &[[9; 3]; 64], 90).unwrap();
        let found = [eight, jpeg, sixteen, floats].map(|bytes| bit_depth(&bytes).unwrap());
        assert_eq!(found, [BitDepth::Eight, BitDepth::Eight, BitDepth::Sixteen, BitDepth::Sixteen]);
        assert_eq!(bit_depth(b"").unwrap_err(), ImageFileError::Empty);
    }

    #[test]
    fn jpeg_and_webp_are_detected_by_content() {
        let jpeg = encode_jpeg(16, 16, &[[200, 100, 50]; 256], 95).unwrap();
        let p = decode(&jpeg, 256).unwrap().pixels[17];
        assert!((p[0] - 200.0 / 255.0).abs() < 0.02 && p[3] == 1.0, "{p:?}");
        let mut webp = Vec::new();
        image::codecs::webp::WebPEncoder::new_lossless(&mut webp)
            .write_image(&[10, 20, 30, 40], 1, 1, ExtendedColorType::Rgba8)
            .unwrap();
        assert_eq!(decode(&webp, 1).unwrap().pixels[0], [10u8, 20, 30, 40].map(|v| f32::from(v) / 255.0));
    }

    fn tiff(width: u32, height: u32, samples: &[u8], kind: ExtendedColorType) -> Vec<u8> {
        let mut file = Cursor::new(Vec::new());
        let encoder = image::codecs::tiff::TiffEncoder::new(&mut file);
        encoder.write_image(samples, width, height, kind).unwrap();
        file.into_inner()
    }

    #[test]
    fn integer_tiff_is_display_encoded_and_float_tiff_is_linear() {
        let eight = tiff(2, 1, &[0, 51, 255, 102, 0, 204], ExtendedColorType::Rgb8);
        assert_eq!(dimensions(&eight).unwrap(), (2, 1));
        assert_eq!(decode(&eight, 2).unwrap().pixels, [[0.0, 0.2, 1.0, 1.0], [0.4, 0.0, 0.8, 1.0]]);
        let sixteen: Vec<u8> = [65_535u16, 1, 0, 32_768].iter().flat_map(|v| v.to_ne_bytes()).collect();
        let back = decode(&tiff(1, 1, &sixteen, ExtendedColorType::Rgba16), 1).unwrap().pixels[0];
        assert_eq!(back, [1.0, 1.0 / 65_535.0, 0.0, 32_768.0 / 65_535.0]);
        let light: Vec<u8> = [0.5f32, 7.0, f32::NAN].iter().flat_map(|v| v.to_ne_bytes()).collect();
        let back = decode(&tiff(1, 1, &light, ExtendedColorType::Rgb32F), 1).unwrap().pixels[0];
        assert_eq!([back[0], back[2], back[3]], [srgb::encode(0.5), 0.0, 1.0], "linear light, encoded");
        assert!(back[1] <= 1.0 && back[1] > 0.999_999, "and clamped: {}", back[1]);
    }

    #[test]
    fn truncated_or_corrupt_tiff_never_panics() {
        let whole = tiff(5, 4, &[77; 60], ExtendedColorType::Rgb8);
        assert!(decode(&whole, 19).is_err(), "more pixels than are allowed");
        for n in 0..whole.len() {
            assert!(decode(&whole[..n], 20).is_err(), "{n} bytes");
            for value in [0, 1, 0x7f, 0xff] {
                let mut bent = whole.clone();
                bent[n] = value;
                if let Ok(image) = decode(&bent, 20) {
                    assert_eq!(image.pixels.len(), image.width as usize * image.height as usize);
                }
            }
        }
    }

    #[test]
    fn reduction_while_decoding_equals_reduction_afterwards() {
        let image = gradient();
        let half = |(width, height): (u32, u32)| (width / 2, height.div_ceil(2));
        let (reduced, stored) = decode_reduced(&encode_rgba(&image).unwrap(), 12, half).unwrap();
        assert_eq!((stored, (reduced.width, reduced.height)), ((4, 3), (2, 2)));
        let whole = decode(&encode_rgba(&image).unwrap(), 12).unwrap();
        assert_eq!(reduced, whole.resized(2, 2));
        assert_ne!(reduced.pixels, whole.pixels[..4], "the control: not the unreduced pixels");
    }

    #[test]
    fn too_large_header_is_refused_before_decoding() {
        let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR".to_vec();
        png.extend([0, 0, 0x4e, 0x20, 0, 0, 0x4e, 0x20, 8, 6, 0, 0, 0, 0, 0, 0, 0]);
        let error = decode(&png, DEFAULT_MAX_PIXELS).unwrap_err();
        assert!(matches!(error, ImageFileError::TooManyPixels { width: 20_000, height: 20_000, .. }));
    }

    #[test]
    fn empty_text_and_truncated_files_give_clear_errors() {
        assert_eq!(decode(b"", 1).unwrap_err(), ImageFileError::Empty);
        let text = decode(b"hello, I am a picture", 1).unwrap_err();
        assert!(text.to_string().contains("hello"), "{text}");
        let whole = encode_rgba(&gradient()).unwrap();
        let cut = decode(&whole[..whole.len() - 30], 12).unwrap_err();
        assert!(matches!(cut, ImageFileError::Damaged(_)), "{cut}");
    }

    #[test]
    fn encoder_refuses_pixel_buffers_of_wrong_length() {
        assert!(encode_png(2, 2, &[[0u8; 3]; 3]).is_err());
        assert!(encode_png(1, 1, &[[0u8; 2]; 1]).is_err());
        assert!(encode_jpeg(0, 0, &[], 90).is_err());
    }
}
