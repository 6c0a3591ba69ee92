//! Pixels of photographs in the layout of the shaders (`shaders/shared/photo.wgsl`).

use crate::gpu::Buffer;
use relume_scene::DisplayRange;

/// Red and green, then blue and mask of a pixel, the first of each pair in the lower half of the word: levels of 1/65535, for
/// colours of the white of the photograph's range over 65535. In the range `Unit` levels of 1/255 are exact.
pub type PhotoPixel = [u32; 2];

/// A photograph in device memory.
#[derive(Debug, Clone)]
pub struct DevicePhoto {
    /// Its pixels, row-major.
    pub pixels: Buffer<PhotoPixel>,
    /// Range of its colours.
    pub range: DisplayRange,
}

/// The nearest levels of `r g b`, clamped to `range`, and of the mask, clamped to [0, 1].
pub fn photo_pixel([r, g, b, mask]: [f32; 4], range: DisplayRange) -> PhotoPixel {
    let level = |v: f32| (v.clamp(0.0, 1.0) * 65_535.0).round() as u32;
    let [r, g, b] = [r, g, b].map(|v| level(v / range.white()));
    let mask = level(mask);
    [r | g << 16, b | mask << 16]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photo_pixel_keeps_8_bit_levels_and_channel_positions() {
        for level in [0u32, 1, 77, 254, 255] {
            let [low, _] = photo_pixel([level as f32 / 255.0, 0.0, 0.0, 0.0], DisplayRange::Unit);
            assert_eq!(low, 257 * level);
        }
        assert_eq!(photo_pixel([0.0, 1.0, 0.0, 0.0], DisplayRange::Unit), [0xffff_0000, 0]);
        assert_eq!(photo_pixel([f32::NAN, -3.0, 1.0, 9.0], DisplayRange::Unit), [0, 0xffff_ffff]);
    }

    #[test]
    fn extended_range_scales_colours_and_not_masks() {
        let white = DisplayRange::Extended.white();
        let [low, high] = photo_pixel([white, 0.5 * white, 99.0, 1.0], DisplayRange::Extended);
        assert_eq!([low, high], [0x8000_ffff, 0xffff_ffff]);
        assert_eq!(
            photo_pixel([white, 0.5 * white, 99.0, 1.0], DisplayRange::Unit),
            [0xffff_ffff; 2],
            "the control"
        );
    }
}
