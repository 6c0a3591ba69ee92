//! The colour matrix of a camera, and its application to photographs.

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use relume_scene::{DisplayRange, ImageRgba, srgb};

/// Distance from the white of a range below which a display value is clipped: less than a level of 16 bits.
const WHITE_TOLERANCE: f32 = 5e-6;

/// Whether a display value is at the white of `range`.
pub(super) fn is_clipped(value: f32, range: DisplayRange) -> bool {
    value >= range.white() - WHITE_TOLERANCE
}

/// Linear light of a display value of any range.
pub(super) fn linear(value: f32) -> f32 {
    if value > 1.0 { ((value + 0.055) / 1.055).powf(2.4) } else { srgb::decode(value) }
}

/// Rows of a 3 x 3 matrix that is applied to linear Rec.709 colours.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ColourMatrix(pub [[f64; 3]; 3]);

impl ColourMatrix {
    pub(super) fn of(matrix: DMat3) -> Self {
        Self(matrix.transpose().to_cols_array_2d())
    }

    /// The product with a linear colour; negative channels become 0.
    pub fn apply(&self, colour: [f32; 3]) -> [f32; 3] {
        let colour = DVec3::from(colour.map(f64::from));
        self.0.map(|row| DVec3::from(row).dot(colour).max(0.0) as f32)
    }

    /// Applies the matrix to the linear colours of `image`, display values in `range` with straight alpha. A channel that is clipped at the
    /// white of `range` stays clipped; the others end at it.
    pub fn apply_to_image(&self, image: &mut ImageRgba, range: DisplayRange) {
        let white = range.white();
        for pixel in &mut image.pixels {
            let [r, g, b, alpha] = *pixel;
            let product = self.apply([r, g, b].map(linear));
            let shown: [f32; 3] = std::array::from_fn(|c| match is_clipped([r, g, b][c], range) {
                true => white,
                false => srgb::encode_extended(product[c].min(range.peak())).min(white),
            });
            *pixel = [shown[0], shown[1], shown[2], alpha];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_compare::largest_difference;

    const MATRIX: ColourMatrix = ColourMatrix([[0.9, 0.2, -0.3], [0.0, 1.4, 0.1], [0.0, 0.0, 2.0]]);

    fn applied(colour: [f32; 3], range: DisplayRange) -> [f32; 3] {
        let [r, g, b] = colour.map(srgb::encode_extended);
        let mut image = ImageRgba { width: 1, height: 1, pixels: vec![[r, g, b, 0.5]] };
        MATRIX.apply_to_image(&mut image, range);
        let [r, g, b, alpha] = image.pixels[0];
        assert!((alpha - 0.5).abs() < 1e-9);
        [r, g, b].map(linear)
    }

    #[test]
    fn matrix_is_applied_to_linear_colours_within_the_range() {
        let unit = DisplayRange::Unit;
        assert!(largest_difference(&applied([0.4, 0.2, 0.1], unit), &[0.37, 0.29, 0.2]) < 1e-5);
        assert!(largest_difference(&applied([0.4, 0.2, 0.1], unit), &[0.4, 0.2, 0.1]) > 0.05, "the control");
        assert_eq!(applied([0.0, 0.0, 0.2], unit)[0], 0.0, "no negative light");
        assert!(largest_difference(&applied([0.5, 0.9, 0.7], unit), &[0.42, 1.0, 1.0]) < 1e-5);
        let brighter = applied([0.5, 0.9, 0.7], DisplayRange::Extended);
        assert!(
            largest_difference(&brighter, &[0.42, 1.33, 1.4]) < 1e-4,
            "linear light continues: {brighter:?}"
        );
    }

    #[test]
    fn clipped_channels_stay_clipped() {
        let clipped = applied([1.0, 0.5, 0.4], DisplayRange::Unit);
        assert!(largest_difference(&clipped, &[1.0, 0.74, 0.8]) < 1e-5, "{clipped:?}");
        let below = applied([0.99, 0.5, 0.4], DisplayRange::Unit);
        assert!(below[0] < 0.9, "the control: {below:?}");
    }
}
