//! What one photograph tells by itself.

use super::overlap::Thumbnail;
use crate::formats::exif_data::{self, ExifData};
use crate::formats::image_file;
use crate::sharpness::{SIDE, luma, sharpness};
use crate::{CaptureError, ImportOptions};
use relume_scene::ImageRgba;

/// A channel from here on is clipped.
const WHITE: f32 = 253.5 / 255.0;

/// What one photograph tells.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PhotoStats {
    /// Its name.
    pub name: String,
    /// Width and height, pixels.
    pub size: (u32, u32),
    /// Variance of the Laplacian, see `sharpness.rs`; to be compared with that of other photographs of the thing.
    pub sharpness: f64,
    /// Mean luma as displayed, 0 to 1.
    pub brightness: f64,
    /// Share of pixels with a channel at white, 0 to 1.
    pub clipped: f64,
    /// How much it resembles the photograph that it resembles most, -1 to 1; 0 where there is no other.
    pub overlap: f64,
    /// What the camera noted.
    pub camera: ExifData,
}

/// Looks at a photograph, reduced.
pub(super) fn analyse(name: &str, bytes: &[u8]) -> Result<(PhotoStats, Thumbnail), CaptureError> {
    let reduce = |size| ImportOptions::at_most(SIDE).reduced_size(size);
    let decoded = image_file::decode_reduced(bytes, image_file::DEFAULT_MAX_PIXELS, reduce);
    let (image, size) = decoded.map_err(|error| CaptureError::image(name, error))?;
    let stats = stats(name, &image, size, exif_data::read(bytes));
    Ok((stats, Thumbnail::of(&image)))
}

/// What a reduced image of a photograph of `size` pixels tells; what is transparent does not count.
pub(super) fn stats(name: &str, image: &ImageRgba, size: (u32, u32), camera: ExifData) -> PhotoStats {
    let opaque = |pixel: &[f32; 4]| f64::from(pixel[3]);
    let count = image.pixels.iter().map(opaque).sum::<f64>().max(1e-6);
    let is_clipped = |pixel: &&[f32; 4]| pixel[..3].iter().any(|v| *v >= WHITE);
    PhotoStats {
        name: name.to_owned(),
        size,
        sharpness: sharpness(image),
        brightness: image.pixels.iter().map(|pixel| opaque(pixel) * luma(pixel)).sum::<f64>() / count,
        clipped: image.pixels.iter().filter(is_clipped).map(opaque).sum::<f64>() / count,
        overlap: 0.0,
        camera,
    }
}
