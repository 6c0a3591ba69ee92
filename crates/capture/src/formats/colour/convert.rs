//! Converts decoded pixels to sRGB.

use std::sync::Arc;

use image::DynamicImage;
use moxcms::{
    ColorProfile, DataColorSpace, Layout, RenderingIntent, Transform8BitExecutor, Transform16BitExecutor,
    TransformExecutor, TransformOptions,
};

use super::profile::{NamedProfile, Unusable, profile_of};
use super::stated::StatedColour;

/// Greatest change of an 8-bit value by a profile that is sRGB in effect.
const SAME: u8 = 1;
/// Greatest difference of an element of a matrix from the identity for a profile with the primaries of sRGB.
const SAME_PRIMARIES: f64 = 2e-3;
/// Number of pixels that are converted together.
const BLOCK: usize = 4096;

const UNSUPPORTED: &str = "this kind of profile is not supported";
const NOT_GREY: &str = "it is a grey profile, and the picture has colours";

/// The conversion of a photograph to sRGB.
#[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum ColourConversion {
    /// The file states no colour space, or sRGB: its values are unchanged.
    #[default]
    None,
    /// The values are converted from the colour profile of this name.
    Converted(String),
    /// The profile cannot be used: the values are taken as sRGB.
    Ignored {
        /// Name of the profile.
        profile: String,
        /// The reason.
        reason: &'static str,
    },
}

/// Converts an image to sRGB with clipping, unless its colour space is sRGB in effect: by the values, not by the name.
/// Alpha is unchanged. Floating-point images are linear: only their primaries are converted.
pub(in crate::formats) fn convert(image: &mut DynamicImage, stated: &StatedColour) -> ColourConversion {
    let NamedProfile { name, profile } = match profile_of(stated) {
        Ok(found) => found,
        Err(Unusable { name, reason }) => return ColourConversion::Ignored { profile: name, reason },
    };
    match convert_pixels(image, &profile) {
        Ok(true) => ColourConversion::Converted(name),
        Ok(false) => ColourConversion::None,
        Err(reason) => ColourConversion::Ignored { profile: name, reason },
    }
}

/// [`convert`]; returns whether the values are converted, or why they cannot be.
fn convert_pixels(image: &mut DynamicImage, profile: &ColorProfile) -> Result<bool, &'static str> {
    use DynamicImage as D;
    let is_grey = profile.color_space == DataColorSpace::Gray;
    match image {
        D::ImageRgb32F(image) => return linear::<3>(image, profile),
        D::ImageRgba32F(image) => return linear::<4>(image, profile),
        D::ImageRgb8(_) | D::ImageRgba8(_) | D::ImageRgb16(_) | D::ImageRgba16(_) if is_grey => {
            return Err(NOT_GREY);
        }
        _ if is_srgb(profile)? => return Ok(false),
        D::ImageRgb8(image) => in_blocks(image, 3, &*transform8(profile, Layout::Rgb)?)?,
        D::ImageRgba8(image) => in_blocks(image, 4, &*transform8(profile, Layout::Rgba)?)?,
        D::ImageRgb16(image) => in_blocks(image, 3, &*transform16(profile, Layout::Rgb)?)?,
        D::ImageRgba16(image) => in_blocks(image, 4, &*transform16(profile, Layout::Rgba)?)?,
        D::ImageLuma8(image) => by_table::<_, 1>(image, &grey_table8(profile)?),
        D::ImageLumaA8(image) => by_table::<_, 2>(image, &grey_table8(profile)?),
        D::ImageLuma16(image) => by_table::<_, 1>(image, &grey_table16(profile)?),
        D::ImageLumaA16(image) => by_table::<_, 2>(image, &grey_table16(profile)?),
        _ => return Err(UNSUPPORTED),
    }
    Ok(true)
}

fn options(profile: &ColorProfile) -> TransformOptions {
    // A profile may have only the table of the perceptual intent, which then serves all intents.
    let only_perceptual =
        profile.lut_a_to_b_perceptual.is_some() && profile.lut_a_to_b_colorimetric.is_none();
    TransformOptions {
        rendering_intent: match only_perceptual {
            true => RenderingIntent::Perceptual,
            false => RenderingIntent::RelativeColorimetric,
        },
        allow_use_cicp_transfer: false,
        prefer_fixed_point: false,
        ..TransformOptions::default()
    }
}

/// The layout of the result of a conversion from `source`.
fn target(source: Layout) -> Layout {
    if source == Layout::Gray { Layout::Rgb } else { source }
}

fn transform8(profile: &ColorProfile, source: Layout) -> Result<Arc<Transform8BitExecutor>, &'static str> {
    let srgb = ColorProfile::new_srgb();
    profile.create_transform_8bit(source, &srgb, target(source), options(profile)).map_err(|_| UNSUPPORTED)
}

fn transform16(profile: &ColorProfile, source: Layout) -> Result<Arc<Transform16BitExecutor>, &'static str> {
    let srgb = ColorProfile::new_srgb();
    profile.create_transform_16bit(source, &srgb, target(source), options(profile)).map_err(|_| UNSUPPORTED)
}

/// Whether a conversion changes 8-bit values by at most [`SAME`]: on a grid of colours, or on all grey values.
fn is_srgb(profile: &ColorProfile) -> Result<bool, &'static str> {
    if profile.color_space == DataColorSpace::Gray {
        let table = grey_table8(profile)?;
        return Ok(table.iter().zip(0..=255u8).all(|(new, old)| new.abs_diff(old) <= SAME));
    }
    const STEPS: usize = 16;
    let level = |i: usize| (i % (STEPS + 1) * 255 / STEPS) as u8;
    let side = STEPS + 1;
    let colours = (0..side * side * side).flat_map(|i| [level(i), level(i / side), level(i / side / side)]);
    let greys = (0..=255u8).flat_map(|v| [v; 3]);
    let old: Vec<u8> = colours.chain(greys).collect();
    let mut new = old.clone();
    in_blocks(&mut new, 3, &*transform8(profile, Layout::Rgb)?)?;
    Ok(old.iter().zip(&new).all(|(old, new)| old.abs_diff(*new) <= SAME))
}

/// Converts interleaved samples, `channels` a pixel, in place.
fn in_blocks<T: Copy + Default>(
    samples: &mut [T],
    channels: usize,
    transform: &dyn TransformExecutor<T>,
) -> Result<(), &'static str> {
    let mut source = Vec::with_capacity(BLOCK * channels);
    for block in samples.chunks_mut(BLOCK * channels) {
        source.clear();
        source.extend_from_slice(block);
        transform.transform(&source, block).map_err(|_| UNSUPPORTED)?;
    }
    Ok(())
}

/// The converted value of each 8-bit grey value.
fn grey_table8(profile: &ColorProfile) -> Result<Vec<u8>, &'static str> {
    let values: Vec<u8> = (0..=u8::MAX).collect();
    grey_table(&values, profile, |source| transform8(profile, source))
}

/// The converted value of each 16-bit grey value.
fn grey_table16(profile: &ColorProfile) -> Result<Vec<u16>, &'static str> {
    let values: Vec<u16> = (0..=u16::MAX).collect();
    grey_table(&values, profile, |source| transform16(profile, source))
}

/// The converted greys. A grey of an RGB profile has three equal values; the green value of the result is used.
fn grey_table<T: Copy + Default>(
    values: &[T],
    profile: &ColorProfile,
    transform: impl Fn(Layout) -> Result<Arc<dyn TransformExecutor<T> + Send + Sync>, &'static str>,
) -> Result<Vec<T>, &'static str> {
    let is_grey = profile.color_space == DataColorSpace::Gray;
    let mut converted = vec![T::default(); 3 * values.len()];
    let result = if is_grey {
        transform(Layout::Gray)?.transform(values, &mut converted)
    } else {
        let colours: Vec<T> = values.iter().flat_map(|v| [*v; 3]).collect();
        transform(Layout::Rgb)?.transform(&colours, &mut converted)
    };
    result.map_err(|_| UNSUPPORTED)?;
    Ok(converted.chunks_exact(3).map(|pixel| pixel[1]).collect())
}

/// Replaces the first of the `C` channels of each pixel by its value in a table.
fn by_table<T: Copy + Into<u32>, const C: usize>(samples: &mut [T], table: &[T]) {
    let (pixels, _) = samples.as_chunks_mut::<C>();
    for pixel in pixels {
        let index: u32 = pixel[0].into();
        pixel[0] = table[index as usize];
    }
}

/// Converts linear light to the primaries of sRGB. Pixels have `C` channels, the first three red, green and blue.
fn linear<const C: usize>(samples: &mut [f32], profile: &ColorProfile) -> Result<bool, &'static str> {
    if profile.color_space == DataColorSpace::Gray {
        return Err(NOT_GREY);
    }
    if !profile.is_matrix_shaper() {
        return Err(UNSUPPORTED);
    }
    let matrix = profile.transform_matrix(&ColorProfile::new_srgb()).v;
    let identity = |row: usize, column: usize| if row == column { 1.0 } else { 0.0 };
    let cells = || (0..9).map(|i| (i / 3, i % 3));
    if !cells().all(|(row, column)| matrix[row][column].is_finite()) {
        return Err(UNSUPPORTED);
    }
    if cells().all(|(row, column)| (matrix[row][column] - identity(row, column)).abs() <= SAME_PRIMARIES) {
        return Ok(false);
    }
    let (pixels, _) = samples.as_chunks_mut::<C>();
    for pixel in pixels {
        let [r, g, b] = [0, 1, 2].map(|k: usize| f64::from(pixel[k]));
        for (value, [x, y, z]) in pixel.iter_mut().zip(matrix) {
            *value = (x * r + y * g + z * b) as f32;
        }
    }
    Ok(true)
}
