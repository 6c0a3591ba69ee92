//! Decodes image files.

use std::io::Cursor;

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader};

use super::header::{check_size, damaged, kind};
use super::jpeg_end;
use crate::formats::colour::{self, ColourConversion, StatedColour};
use crate::formats::{ImageFileError, SceneLight, exr_image, heif};
use relume_scene::{ImageRgba, srgb};

/// A decoded photograph.
#[derive(Debug, Clone, PartialEq)]
pub struct Photograph {
    /// Display-encoded sRGB with straight alpha; colours in [`SceneLight::range`].
    pub image: ImageRgba,
    /// Width and height of the file's picture, pixels.
    pub stored: (u32, u32),
    /// The conversion of its colours to sRGB.
    pub colour: ColourConversion,
    /// Its brightness, if it contains linear light.
    pub light: SceneLight,
}

/// The kind of an image file's content, which decides the conversion of its values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Reading {
    /// The values of a mask or map, clamped to [0, 1], without regard to a colour profile.
    Values,
    /// A photograph: its colours are converted, and linear light above 1 is kept.
    Photograph,
}

impl Reading {
    /// Linear light encoded for display; NaN becomes 0.
    fn encode(self, linear: f32) -> f32 {
        match self {
            Self::Values => srgb::encode(linear),
            Self::Photograph => srgb::encode_extended(linear),
        }
    }

    /// [`Self::encode`] of a pixel with straight alpha.
    fn displayed(self, [r, g, b, a]: [f32; 4]) -> [f32; 4] {
        let alpha = if a > 0.0 { a.min(1.0) } else { 0.0 };
        [self.encode(r), self.encode(g), self.encode(b), alpha]
    }
}

/// The values of an image file as RGBA with straight alpha, without regard to a colour profile: for masks and maps. EXR and
/// float TIFF contain linear light, which is encoded with the sRGB curve and clamped. Images without alpha are opaque.
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
    let decoded = decode_with(bytes, max_pixels, reduce, Reading::Values)?;
    Ok((decoded.image, decoded.stored))
}

/// A photograph as display-encoded sRGB. The file's colour profile is converted; values outside sRGB are clipped. A file
/// without a profile is taken as sRGB. Linear light (EXR and float TIFF) is scene-referred: above 1 the curve continues, up to a
/// radiance of [`relume_scene::SCENE_PEAK`]. `reduce` is that of [`decode_reduced`].
///
/// # Errors
/// As [`decode`]. A colour profile that cannot be used is no error: see [`Photograph::colour`].
pub fn decode_photograph(
    bytes: &[u8],
    max_pixels: u64,
    reduce: impl Fn((u32, u32)) -> (u32, u32),
) -> Result<Photograph, ImageFileError> {
    decode_with(bytes, max_pixels, reduce, Reading::Photograph)
}

fn decode_with(
    bytes: &[u8],
    max_pixels: u64,
    reduce: impl Fn((u32, u32)) -> (u32, u32),
    reading: Reading,
) -> Result<Photograph, ImageFileError> {
    check_size(bytes, max_pixels)?;
    if exr_image::is_exr(bytes) {
        let (width, height, linear) = exr_image::decode_rgba(bytes)?;
        let stored = (width, height);
        let pixel = |i: usize| reading.displayed(straightened(linear[i]));
        let image = ImageRgba::reduced(stored, reduce(stored), pixel);
        let light = SceneLight::of(linear.iter().map(|pixel| straightened(*pixel)));
        return Ok(Photograph { image, stored, colour: ColourConversion::None, light });
    }
    let (mut image, stated) = decode_dynamic(bytes, max_pixels)?;
    let colour = match stated.filter(|_| reading == Reading::Photograph) {
        Some(stated) => colour::convert(&mut image, &stated),
        None => ColourConversion::None,
    };
    let stored = (image.width(), image.height());
    let light = light(&image);
    Ok(Photograph { image: reduced(&image, stored, reduce(stored), reading), stored, colour, light })
}

/// The brightness of linear light, which images of floating-point values contain.
fn light(image: &DynamicImage) -> SceneLight {
    match image {
        DynamicImage::ImageRgb32F(image) => {
            SceneLight::of(image.as_chunks::<3>().0.iter().map(|&[r, g, b]| [r, g, b, 1.0]))
        }
        DynamicImage::ImageRgba32F(image) => SceneLight::of(image.as_chunks::<4>().0.iter().copied()),
        _ => SceneLight::default(),
    }
}

/// Decodes a file in the type of its values. Also returns the colour space that it states.
fn decode_dynamic(
    bytes: &[u8],
    max_pixels: u64,
) -> Result<(DynamicImage, Option<StatedColour>), ImageFileError> {
    if heif::is_heif(bytes) {
        let stated = heif::header(bytes)?.colour;
        let png = heif::to_png(bytes)?;
        check_size(&png, max_pixels)?;
        let (image, converted) = decode_dynamic(&png, max_pixels)?;
        return Ok((image, stated.or(converted)));
    }
    let format = kind(bytes)?;
    if format == ImageFormat::Jpeg && !jpeg_end::is_complete(bytes) {
        return Err(ImageFileError::Damaged("the file is truncated: the picture does not end".into()));
    }
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.no_limits();
    let mut decoder = reader.into_decoder().map_err(damaged)?;
    if decoder.total_bytes() > 1 << 32 {
        return Err(ImageFileError::Damaged("it decodes to more than 4 GiB".into()));
    }
    // A profile that cannot be read is treated as absent.
    let profile = decoder.icc_profile().ok().flatten();
    let stated = StatedColour::of_file(bytes, format, profile);
    Ok((DynamicImage::from_decoder(decoder).map_err(damaged)?, stated))
}

/// `image` resized from `stored` to `size`.
fn reduced(image: &DynamicImage, stored: (u32, u32), size: (u32, u32), reading: Reading) -> ImageRgba {
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
        D::ImageRgb32F(image) => of(&|i| reading.displayed(pixel::<_, 3>(image, i, |v| v))),
        D::ImageRgba32F(image) => of(&|i| reading.displayed(pixel::<_, 4>(image, i, |v| v))),
        other => {
            let image = other.to_rgba32f();
            of(&|i| pixel::<_, 4>(&image, i, |v| v))
        }
    }
}

/// Straight alpha from premultiplied, which EXR uses by convention. Alpha above 1 becomes 1; negative alpha and NaN
/// become 0.
fn straightened([r, g, b, a]: [f32; 4]) -> [f32; 4] {
    let a = if a > 0.0 { a.min(1.0) } else { 0.0 };
    let divisor = if a > 0.0 { a } else { 1.0 };
    [r / divisor, g / divisor, b / divisor, a]
}
