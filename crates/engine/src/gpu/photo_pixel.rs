//! Pixels of photographs in the layout of the shaders (`shaders/shared/photo.wgsl`).

/// Red and green, then blue and mask of a pixel: levels of 1/65535, the first of each pair in the lower half of the word.
/// Levels of 1/255 are exact.
pub type PhotoPixel = [u32; 2];

/// The nearest levels of `r g b` and mask, clamped to [0, 1].
pub fn photo_pixel(pixel: [f32; 4]) -> PhotoPixel {
    let [r, g, b, mask] = pixel.map(|v| (v.clamp(0.0, 1.0) * 65_535.0).round() as u32);
    [r | g << 16, b | mask << 16]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photo_pixel_keeps_8_bit_levels_and_channel_positions() {
        for level in [0u32, 1, 77, 254, 255] {
            let [low, _] = photo_pixel([level as f32 / 255.0, 0.0, 0.0, 0.0]);
            assert_eq!(low, 257 * level);
        }
        assert_eq!(photo_pixel([0.0, 1.0, 0.0, 0.0]), [0xffff_0000, 0]);
        assert_eq!(photo_pixel([f32::NAN, -3.0, 1.0, 9.0]), [0, 0xffff_ffff]);
    }
}
