//! Statistics of one photograph.

use std::borrow::Cow;
use std::hash::{DefaultHasher, Hash, Hasher};

use super::overlap::Thumbnail;
use crate::formats::ColourConversion;
use crate::formats::exif_data::{self, ExifData};
use crate::formats::image_file::{self, Photograph};
use crate::sharpness::{SIDE, luma, sharpness};
use crate::{CaptureError, ImportOptions};
use relume_scene::{DisplayRange, ImageRgba};

/// Least value of a clipped channel.
const WHITE: f32 = 253.5 / 255.0;

/// Statistics of one photograph.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PhotoStats {
    /// File name.
    pub name: String,
    /// Width and height, pixels.
    pub size: (u32, u32),
    /// Variance of the Laplacian, see `crates/capture/src/sharpness.rs`. Compare it only with photographs of the same
    /// scene.
    pub sharpness: f64,
    /// Mean luma as displayed, 0 to 1.
    pub brightness: f64,
    /// Share of pixels with a clipped channel, 0 to 1.
    pub clipped: f64,
    /// Similarity to the most similar photograph, -1 to 1; 0 for a single photograph.
    pub overlap: f64,
    /// The camera's settings from EXIF.
    pub camera: ExifData,
    /// The conversion of its colours to sRGB.
    pub colour: ColourConversion,
    /// `Extended` if it contains linear light brighter than white.
    pub range: DisplayRange,
    /// Hash of the decoded pixels, reduced for the checks: equal for identical photographs.
    pub digest: u64,
}

/// Decodes a photograph at a reduced size and computes its statistics.
pub(super) fn analyse(name: &str, bytes: &[u8]) -> Result<(PhotoStats, Thumbnail), CaptureError> {
    let reduce = |size| ImportOptions::at_most(SIDE).reduced_size(size);
    let decoded = image_file::decode_photograph(bytes, image_file::DEFAULT_MAX_PIXELS, reduce);
    let decoded = decoded.map_err(|error| CaptureError::image(name, error))?;
    let Photograph { image, stored, colour, light } = decoded;
    let stats = stats(name, (&image, light.range), stored, exif_data::read(bytes), colour);
    Ok((stats, Thumbnail::of(&image)))
}

/// Statistics of a reduced image of a photograph of `size` pixels; transparent pixels do not count.
pub(super) fn stats(
    name: &str,
    (image, range): (&ImageRgba, DisplayRange),
    size: (u32, u32),
    camera: ExifData,
    colour: ColourConversion,
) -> PhotoStats {
    let opaque = |pixel: &[f32; 4]| f64::from(pixel[3]);
    let count = image.pixels.iter().map(opaque).sum::<f64>().max(1e-6);
    let is_clipped = |pixel: &&[f32; 4]| pixel[..3].iter().any(|v| *v >= WHITE * range.white());
    let clipped = image.pixels.iter().filter(is_clipped).map(opaque).sum::<f64>() / count;
    // What a display shows is compared, so that few very bright pixels do not outweigh the others.
    let shown = match range {
        DisplayRange::Unit => Cow::Borrowed(image),
        DisplayRange::Extended => Cow::Owned(image.shown()),
    };
    PhotoStats {
        name: name.to_owned(),
        size,
        sharpness: sharpness(&shown),
        brightness: shown.pixels.iter().map(|pixel| opaque(pixel) * luma(pixel)).sum::<f64>() / count,
        clipped,
        range,
        overlap: 0.0,
        camera,
        colour,
        digest: digest(image, size),
    }
}

fn digest(image: &ImageRgba, size: (u32, u32)) -> u64 {
    let mut hasher = DefaultHasher::new();
    size.hash(&mut hasher);
    image.pixels.as_flattened().iter().for_each(|value| value.to_bits().hash(&mut hasher));
    hasher.finish()
}
