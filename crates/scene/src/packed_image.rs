//! Photographs in memory: integers of 8 or 16 bits per channel, decoded on each read.

use std::sync::Arc;

use crate::{DisplayRange, ImageRgba};

/// Bits per channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BitDepth {
    /// Levels of 1/255.
    Eight,
    /// Levels of 1/65535; of `DisplayRange::Extended.white() / 65535` for the colours of scene-referred photographs.
    Sixteen,
}

/// A photograph with 3 channels where it is opaque and 4 elsewhere. A clone shares the pixels.
///
/// A value that is a level of the bit depth, as every value of an image file of integers is, round-trips exactly. The values of
/// scene-referred photographs are spaced by 9e-5.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct PackedImage {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    range: DisplayRange,
    samples: Samples,
}

/// Row-major pixels.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
enum Samples {
    Rgb8(Arc<[[u8; 3]]>),
    Rgba8(Arc<[[u8; 4]]>),
    Rgb16(Arc<[[u16; 3]]>),
    Rgba16(Arc<[[u16; 4]]>),
}

/// The value of each 8-bit level.
const LEVELS8: [f32; 256] = {
    let mut levels = [0.0; 256];
    let mut i = 0;
    while i < 256 {
        levels[i] = i as f32 / 255.0;
        i += 1;
    }
    levels
};

/// The nearest 8-bit level; NaN becomes 0.
fn level8(v: f32) -> u8 {
    (v * 255.0).round() as u8
}

/// The nearest 16-bit level; NaN becomes 0.
fn level16(v: f32) -> u16 {
    (v * 65_535.0).round() as u16
}

fn value8(level: u8) -> f32 {
    LEVELS8[usize::from(level)]
}

fn value16(level: u16) -> f32 {
    f32::from(level) / 65_535.0
}

impl PackedImage {
    /// `image` clamped to [0, 1] and rounded to levels of `depth`. The result is opaque where every alpha rounds to 1.
    pub fn new(image: &ImageRgba, depth: BitDepth) -> Self {
        Self::packed(image, depth, DisplayRange::Unit)
    }

    /// A scene-referred photograph at 16 bits: `image` clamped to [`DisplayRange::Extended`] and rounded to its levels. Without a
    /// colour above 1 the result is that of [`Self::new`].
    pub fn scene_referred(image: &ImageRgba) -> Self {
        let exceeds = |p: &[f32; 4]| p[..3].iter().any(|v| *v > 1.0);
        let range = match image.pixels.iter().any(exceeds) {
            true => DisplayRange::Extended,
            false => DisplayRange::Unit,
        };
        Self::packed(image, BitDepth::Sixteen, range)
    }

    /// `image` clamped to `range`, which is `Unit` for 8 bits, and rounded to levels of `depth`.
    fn packed(image: &ImageRgba, depth: BitDepth, range: DisplayRange) -> Self {
        let is_opaque = match depth {
            BitDepth::Eight => image.pixels.iter().all(|p| level8(p[3]) == u8::MAX),
            BitDepth::Sixteen => image.pixels.iter().all(|p| level16(p[3]) == u16::MAX),
        };
        let colour16 = |v: f32| level16(v / range.white());
        let pixels = image.pixels.iter();
        let samples = match (depth, is_opaque) {
            (BitDepth::Eight, true) => {
                Samples::Rgb8(pixels.map(|&[r, g, b, _]| [r, g, b].map(level8)).collect())
            }
            (BitDepth::Eight, false) => Samples::Rgba8(pixels.map(|p| p.map(level8)).collect()),
            (BitDepth::Sixteen, true) => {
                Samples::Rgb16(pixels.map(|&[r, g, b, _]| [r, g, b].map(colour16)).collect())
            }
            (BitDepth::Sixteen, false) => {
                let packed = |&[r, g, b, a]: &[f32; 4]| [colour16(r), colour16(g), colour16(b), level16(a)];
                Samples::Rgba16(pixels.map(packed).collect())
            }
        };
        Self { width: image.width, height: image.height, range, samples }
    }

    /// Bits per channel.
    pub fn depth(&self) -> BitDepth {
        match self.samples {
            Samples::Rgb8(_) | Samples::Rgba8(_) => BitDepth::Eight,
            Samples::Rgb16(_) | Samples::Rgba16(_) => BitDepth::Sixteen,
        }
    }

    /// Range of the colours: `Extended` for scene-referred photographs with a colour above 1.
    pub fn range(&self) -> DisplayRange {
        self.range
    }

    /// True when no pixel is transparent.
    pub fn is_opaque(&self) -> bool {
        matches!(self.samples, Samples::Rgb8(_) | Samples::Rgb16(_))
    }

    /// Number of pixels.
    pub fn len(&self) -> usize {
        match &self.samples {
            Samples::Rgb8(pixels) => pixels.len(),
            Samples::Rgba8(pixels) => pixels.len(),
            Samples::Rgb16(pixels) => pixels.len(),
            Samples::Rgba16(pixels) => pixels.len(),
        }
    }

    /// True when there are no pixels.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Bytes of memory of the pixels, which all clones share.
    pub fn bytes(&self) -> usize {
        match &self.samples {
            Samples::Rgb8(pixels) => size_of_val(&pixels[..]),
            Samples::Rgba8(pixels) => size_of_val(&pixels[..]),
            Samples::Rgb16(pixels) => size_of_val(&pixels[..]),
            Samples::Rgba16(pixels) => size_of_val(&pixels[..]),
        }
    }

    /// True when both are clones of one image and share its pixels.
    pub fn shares_pixels_with(&self, other: &Self) -> bool {
        match (&self.samples, &other.samples) {
            (Samples::Rgb8(a), Samples::Rgb8(b)) => Arc::ptr_eq(a, b),
            (Samples::Rgba8(a), Samples::Rgba8(b)) => Arc::ptr_eq(a, b),
            (Samples::Rgb16(a), Samples::Rgb16(b)) => Arc::ptr_eq(a, b),
            (Samples::Rgba16(a), Samples::Rgba16(b)) => Arc::ptr_eq(a, b),
            _ => false,
        }
    }

    /// Pixel `i`, row-major: `r g b a`, straight alpha; colours in [`Self::range`], alpha in [0, 1].
    #[inline]
    pub fn pixel(&self, i: usize) -> [f32; 4] {
        match &self.samples {
            Samples::Rgb8(pixels) => opaque(pixels[i].map(value8)),
            Samples::Rgba8(pixels) => pixels[i].map(value8),
            Samples::Rgb16(pixels) => opaque(pixels[i].map(|level| self.colour16(level))),
            Samples::Rgba16(pixels) => {
                let [r, g, b, a] = pixels[i];
                [self.colour16(r), self.colour16(g), self.colour16(b), value16(a)]
            }
        }
    }

    #[inline]
    fn colour16(&self, level: u16) -> f32 {
        value16(level) * self.range.white()
    }

    /// All pixels in row-major order, each as from [`Self::pixel`].
    pub fn pixels(&self) -> impl ExactSizeIterator<Item = [f32; 4]> + '_ {
        (0..self.len()).map(|i| self.pixel(i))
    }

    /// The alpha channel, row-major.
    pub fn alpha(&self) -> Vec<f32> {
        self.pixels().map(|p| p[3]).collect()
    }

    /// The image as floats, colours in [`Self::range`].
    pub fn decoded(&self) -> ImageRgba {
        ImageRgba { width: self.width, height: self.height, pixels: self.pixels().collect() }
    }

    /// The image as floats with its colours clamped to [0, 1], as a display shows it.
    pub fn shown(&self) -> ImageRgba {
        match self.range {
            DisplayRange::Unit => self.decoded(),
            DisplayRange::Extended => self.decoded().shown(),
        }
    }

    /// The image reduced to `width` x `height` by area averaging with premultiplied alpha, at the same depth and range. At
    /// this image's own size the result shares its pixels.
    #[must_use]
    pub fn resized(&self, width: u32, height: u32) -> Self {
        if (width, height) == (self.width, self.height) {
            return self.clone();
        }
        let reduced = ImageRgba::reduced((self.width, self.height), (width, height), |i| self.pixel(i));
        Self::packed(&reduced, self.depth(), self.range)
    }
}

fn opaque([r, g, b]: [f32; 3]) -> [f32; 4] {
    [r, g, b, 1.0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_compare::{largest_difference, worst};

    /// One row whose red is every level of `levels`, and, if `transparent`, an alpha one level below 1 in the first pixel.
    fn ramp(levels: u32, transparent: bool) -> ImageRgba {
        let last = (levels - 1) as f32;
        let value = |n: u32| n as f32 / last;
        let pixel = |n: u32| {
            let alpha = if transparent && n == 0 { value(levels - 2) } else { 1.0 };
            [value(n), value(levels - 1 - n), value(n / 2), alpha]
        };
        ImageRgba { width: levels, height: 1, pixels: (0..levels).map(pixel).collect() }
    }

    #[test]
    fn packed_image_round_trips_file_levels_exactly() {
        for transparent in [false, true] {
            let (eight, sixteen) = (ramp(256, transparent), ramp(65_536, transparent));
            assert_eq!(PackedImage::new(&eight, BitDepth::Eight).decoded(), eight);
            assert_eq!(PackedImage::new(&sixteen, BitDepth::Sixteen).decoded(), sixteen);
            let coarse = PackedImage::new(&sixteen, BitDepth::Eight).decoded();
            assert_ne!(coarse, sixteen, "the control: 8 bits do not hold 16");
            let error = largest_difference(coarse.pixels.as_flattened(), sixteen.pixels.as_flattened());
            assert!(error <= 0.5 / 255.0 + 1e-6, "{error}");
        }
    }

    #[test]
    fn opaque_images_store_three_channels_and_others_four() {
        let bytes = |transparent, depth| PackedImage::new(&ramp(256, transparent), depth).bytes() / 256;
        assert_eq!(bytes(false, BitDepth::Eight), 3);
        assert_eq!(bytes(true, BitDepth::Eight), 4);
        assert_eq!([bytes(false, BitDepth::Sixteen), bytes(true, BitDepth::Sixteen)], [6, 8]);
    }

    #[test]
    fn out_of_range_values_are_clamped_and_nan_becomes_black() {
        let image = ImageRgba { width: 1, height: 1, pixels: vec![[-1.0, 2.0, f32::NAN, 1.0]] };
        for depth in [BitDepth::Eight, BitDepth::Sixteen] {
            assert_eq!(PackedImage::new(&image, depth).pixel(0), [0.0, 1.0, 0.0, 1.0]);
        }
    }

    /// One row of scene-referred colours, from black to far above the peak, and values that no photograph should have.
    fn radiance(alpha: f32) -> ImageRgba {
        let colours = [0.0, 0.5, 1.0, 1.4, 5.0, 1e9, f32::INFINITY, f32::NAN, -2.0, f32::NEG_INFINITY];
        let pixels: Vec<[f32; 4]> = colours.iter().map(|v| [*v, 0.25, 0.5 * v, alpha]).collect();
        ImageRgba { width: colours.len() as u32, height: 1, pixels }
    }

    #[test]
    fn scene_referred_values_above_1_round_trip() {
        let white = DisplayRange::Extended.white();
        for alpha in [1.0, 0.5] {
            let packed = PackedImage::scene_referred(&radiance(alpha));
            assert_eq!((packed.range(), packed.depth()), (DisplayRange::Extended, BitDepth::Sixteen));
            let red: Vec<f32> = packed.pixels().map(|p| p[0]).collect();
            let expected = [0.0, 0.5, 1.0, 1.4, 5.0, white, white, 0.0, 0.0, 0.0];
            let error = largest_difference(&red, &expected);
            assert!(error <= 0.5 * f64::from(white) / 65_535.0 + 1e-6, "{error}");
            assert!(packed.pixels().all(|p| (p[3] - alpha).abs() < 1e-5), "alpha has levels of 1/65535");
            assert_eq!(packed.is_opaque(), alpha == 1.0);
            assert!(packed.shown().pixels.iter().flatten().all(|v| (0.0..=1.0).contains(v)));
            assert!(packed.resized(5, 1).pixel(2)[0] > 5.0, "{:?}", packed.resized(5, 1).pixel(2));
            let clipped = PackedImage::new(&radiance(alpha), BitDepth::Sixteen);
            assert_eq!((clipped.pixel(4)[0], clipped.range()), (1.0, DisplayRange::Unit), "the control");
        }
    }

    #[test]
    fn scene_referred_values_up_to_1_are_stored_as_others() {
        for transparent in [false, true] {
            let image = ramp(65_536, transparent);
            let packed = PackedImage::scene_referred(&image);
            assert_eq!(packed, PackedImage::new(&image, BitDepth::Sixteen));
            assert_eq!(packed.decoded(), image);
            assert_eq!(packed.shown(), image);
        }
        let mut brighter = ramp(65_536, false);
        brighter.pixels[0][0] = 1.1;
        assert_ne!(PackedImage::scene_referred(&brighter).range(), DisplayRange::Unit, "the control");
    }

    #[test]
    fn resizing_is_accurate_and_equal_size_shares_the_pixels() {
        let packed = PackedImage::new(&ramp(256, true), BitDepth::Eight);
        let (small, exact) = (packed.resized(64, 1), packed.decoded().resized(64, 1));
        let error = worst(small.pixels().zip(&exact.pixels).map(|(a, b)| largest_difference(&a, b)));
        assert!(error > 0.0 && error <= 0.5 / 255.0 + 1e-6, "{error}");
        assert!(packed.resized(256, 1).shares_pixels_with(&packed));
        assert!(!small.shares_pixels_with(&packed), "the control");
    }
}
