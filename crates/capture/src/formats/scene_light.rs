//! The brightness of photographs of linear light, which are scene-referred: their values do not end at white.

use relume_scene::{DisplayRange, SCENE_PEAK};

/// Least alpha of a pixel that counts. In a file of premultiplied half floats, the colour of a nearly transparent pixel is a quotient
/// of rounded numbers.
const MIN_ALPHA: f32 = 1.0 / 255.0;

/// The brightness of a photograph of linear light.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct SceneLight {
    /// `Extended` if a pixel is brighter than the white of a display. Files of integers end at white: `Unit`.
    pub range: DisplayRange,
    /// Share of the stored pixels that are brighter than [`SCENE_PEAK`] and are limited to it, 0 to 1.
    pub limited: f64,
}

impl SceneLight {
    /// The brightness of `pixels`, linear with straight alpha. Pixels of an alpha below 1/255 do not count.
    pub(super) fn of(pixels: impl ExactSizeIterator<Item = [f32; 4]>) -> Self {
        let count = pixels.len().max(1);
        let (mut range, mut limited) = (DisplayRange::Unit, 0usize);
        for [r, g, b, _] in pixels.filter(|pixel| pixel[3] >= MIN_ALPHA) {
            let brightest = r.max(g).max(b);
            if brightest > 1.0 {
                range = DisplayRange::Extended;
                limited += usize::from(brightest > SCENE_PEAK);
            }
        }
        Self { range, limited: limited as f64 / count as f64 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn brightness_counts_visible_pixels_above_white_and_peak() {
        let of = |pixels: &[[f32; 4]]| SceneLight::of(pixels.iter().copied());
        let dark =
            [[1.0, 0.5, f32::NAN, 1.0], [9.0, 9.0, 9.0, 0.0], [2.0, 0.0, 0.0, 1e-6], [-3.0, 0.0, 0.0, 1.0]];
        assert_eq!(of(&dark), SceneLight::default());
        assert_eq!(of(&[]), SceneLight::default());
        let bright = [[0.0, 0.0, 1.5, 0.1], [0.0, f32::INFINITY, f32::NAN, 1.0], [70.0; 4], [64.0; 4]];
        assert_eq!(of(&bright), SceneLight { range: DisplayRange::Extended, limited: 0.5 });
    }
}
