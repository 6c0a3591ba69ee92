//! Primaries of scene-referred images.

use serde::{Deserialize, Serialize};

/// Primaries of linear colours.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Primaries {
    /// Rec.709 and sRGB primaries, white point D65. Relume computes in these primaries.
    #[default]
    Rec709,
    /// AP1 primaries with the ACES white point, the working space of ACES.
    Acescg,
}

/// Linear Rec.709 to ACEScg, adapted from D65 to the ACES white point with Bradford's method.
const REC709_TO_ACESCG: [[f32; 3]; 3] = [
    [0.613_097_4, 0.339_523_15, 0.047_379_45],
    [0.070_193_72, 0.916_353_9, 0.013_452_4],
    [0.020_615_59, 0.109_569_77, 0.869_814_63],
];

impl Primaries {
    /// Converts a linear Rec.709 colour to these primaries.
    pub fn from_rec709(self, [r, g, b]: [f32; 3]) -> [f32; 3] {
        match self {
            Self::Rec709 => [r, g, b],
            Self::Acescg => REC709_TO_ACESCG.map(|row| row[0] * r + row[1] * g + row[2] * b),
        }
    }

    /// Value of the attribute `colorInteropID` of OpenEXR.
    pub fn interop_id(self) -> &'static str {
        match self {
            Self::Rec709 => "lin_rec709_scene",
            Self::Acescg => "lin_ap1_scene",
        }
    }

    /// CIE xy chromaticities of red, green, blue and white.
    pub fn chromaticities(self) -> [[f32; 2]; 4] {
        match self {
            Self::Rec709 => [[0.64, 0.33], [0.3, 0.6], [0.15, 0.06], [0.3127, 0.329]],
            Self::Acescg => [[0.713, 0.293], [0.165, 0.83], [0.128, 0.044], [0.32168, 0.33767]],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec3};
    use relume_compare::worst;

    /// CIE XYZ of chromaticity xy at luminance 1.
    fn xyz([x, y]: [f32; 2]) -> DVec3 {
        let (x, y) = (f64::from(x), f64::from(y));
        DVec3::new(x / y, 1.0, (1.0 - x - y) / y)
    }

    /// Linear RGB to CIE XYZ.
    fn to_xyz(primaries: Primaries) -> DMat3 {
        let [red, green, blue, white] = primaries.chromaticities().map(xyz);
        let columns = DMat3::from_cols(red, green, blue);
        columns * DMat3::from_diagonal(columns.inverse() * white)
    }

    /// Bradford's adaptation of one white to another.
    fn adapted(from: [f32; 2], to: [f32; 2]) -> DMat3 {
        let cones = DMat3::from_cols_array_2d(&[
            [0.8951, -0.7502, 0.0389],
            [0.2664, 1.7135, -0.0685],
            [-0.1614, 0.0367, 1.0296],
        ]);
        cones.inverse() * DMat3::from_diagonal((cones * xyz(to)) / (cones * xyz(from))) * cones
    }

    #[test]
    fn matrix_matches_the_adapted_chromaticities() {
        let [.., white] = Primaries::Rec709.chromaticities();
        let [.., aces_white] = Primaries::Acescg.chromaticities();
        let to_acescg = to_xyz(Primaries::Acescg).inverse();
        let right = to_acescg * adapted(white, aces_white) * to_xyz(Primaries::Rec709);
        let without = to_acescg * to_xyz(Primaries::Rec709);
        let off = |matrix: DMat3| {
            let column =
                |k: usize| Primaries::Acescg.from_rec709([0, 1, 2].map(|i| f32::from(u8::from(i == k))));
            worst((0..3).map(|k| (DVec3::from(column(k).map(f64::from)) - matrix.col(k)).length()))
        };
        assert!(off(right) < 1e-4, "{}", off(right));
        assert!(off(without) > 1e-2, "the control: white not adapted");
    }

    #[test]
    fn acescg_conversion_keeps_white_and_desaturates_red() {
        for value in Primaries::Acescg.from_rec709([1.0; 3]) {
            assert!((value - 1.0).abs() < 1e-5);
        }
        let [r, g, b] = Primaries::Acescg.from_rec709([1.0, 0.0, 0.0]);
        assert!(r < 0.7 && g > 0.05 && b > 0.0);
        assert_eq!(Primaries::Rec709.from_rec709([1.0, 0.0, 0.5]), [1.0, 0.0, 0.5]);
    }
}
