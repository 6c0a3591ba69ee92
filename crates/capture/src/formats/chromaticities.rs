//! Conversion of linear RGB with stated primaries to linear Rec.709, in which Relume computes.
//!
//! The primaries and the white point give the matrix to CIE XYZ (SMPTE RP 177-1993). A white point other than D65 is
//! adapted with Bradford's cone responses (ICC.1:2022, annex E).

use glam::{DMat3, DVec3};

/// CIE xy chromaticities of red, green, blue and white.
pub type Chromaticities = [[f32; 2]; 4];

/// Those of Rec.709 and sRGB, white point D65.
const REC709: Chromaticities = [[0.64, 0.33], [0.3, 0.6], [0.15, 0.06], [0.3127, 0.329]];
/// Primaries that have a name in warnings.
const NAMED: [(&str, Chromaticities); 5] = [
    ("ACEScg (AP1)", [[0.713, 0.293], [0.165, 0.83], [0.128, 0.044], [0.32168, 0.33767]]),
    ("ACES2065-1 (AP0)", [[0.7347, 0.2653], [0.0, 1.0], [0.0001, -0.077], [0.32168, 0.33767]]),
    ("Rec.2020", [[0.708, 0.292], [0.17, 0.797], [0.131, 0.046], [0.3127, 0.329]]),
    ("Display P3", [[0.68, 0.32], [0.265, 0.69], [0.15, 0.06], [0.3127, 0.329]]),
    ("Adobe RGB", [[0.64, 0.33], [0.21, 0.71], [0.15, 0.06], [0.3127, 0.329]]),
];
/// Greatest difference of chromaticities that are written with different numbers of digits.
const SAME: f32 = 1e-3;
/// Least magnitude of the determinant of usable primaries. That of Rec.709 is about 1.3.
const MIN_DETERMINANT: f64 = 1e-3;
/// Negative values down to this share of the largest channel come from rounding in the file, and become 0.
const ROUNDING: f32 = 1e-3;

/// A conversion to linear Rec.709.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToRec709 {
    matrix: DMat3,
    /// Name of the primaries, for warnings.
    pub name: &'static str,
}

/// The error of chromaticities that define no colour space.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UnusableChromaticities;

impl ToRec709 {
    /// The conversion from these primaries; `None` if they are those of Rec.709.
    ///
    /// # Errors
    /// If the primaries or the white point define no colour space: values that are not finite, a white without
    /// luminance, or three primaries on a line.
    pub fn of(from: Chromaticities) -> Result<Option<Self>, UnusableChromaticities> {
        if is_same(from, REC709) {
            return Ok(None);
        }
        let to_xyz = rgb_to_xyz(from).ok_or(UnusableChromaticities)?;
        let from_xyz = rgb_to_xyz(REC709).ok_or(UnusableChromaticities)?.inverse();
        let matrix = from_xyz * adaptation(from[3], REC709[3]) * to_xyz;
        if !matrix.is_finite() {
            return Err(UnusableChromaticities);
        }
        let name = NAMED.iter().find(|(_, named)| is_same(from, *named)).map_or("other primaries", |n| n.0);
        Ok(Some(Self { matrix, name }))
    }

    /// Converts a colour. Colours outside Rec.709 have negative values.
    pub fn apply(&self, rgb: [f32; 3]) -> [f32; 3] {
        let out = (self.matrix * DVec3::from(rgb.map(f64::from))).to_array().map(|v| v as f32);
        let peak = out.iter().copied().fold(0.0, f32::max);
        // NaN is kept.
        out.map(|v| if v < 0.0 && -v <= ROUNDING * peak { 0.0 } else { v })
    }
}

fn is_same(a: Chromaticities, b: Chromaticities) -> bool {
    a.as_flattened().iter().zip(b.as_flattened()).all(|(a, b)| (a - b).abs() <= SAME)
}

/// CIE XYZ of chromaticity xy at luminance 1.
fn xyz([x, y]: [f32; 2]) -> DVec3 {
    let (x, y) = (f64::from(x), f64::from(y));
    DVec3::new(x / y, 1.0, (1.0 - x - y) / y)
}

/// Linear RGB to CIE XYZ, where RGB (1, 1, 1) is the white point at luminance 1 (SMPTE RP 177-1993, section 3.3).
fn rgb_to_xyz([red, green, blue, white]: Chromaticities) -> Option<DMat3> {
    let column = |[x, y]: [f32; 2]| DVec3::new(f64::from(x), f64::from(y), 1.0 - f64::from(x) - f64::from(y));
    let primaries = DMat3::from_cols(column(red), column(green), column(blue));
    let white = xyz(white);
    let is_usable = primaries.determinant().abs() > MIN_DETERMINANT && white.is_finite();
    is_usable.then(|| primaries * DMat3::from_diagonal(primaries.inverse() * white))
}

/// Bradford's adaptation of XYZ from one white point to another.
fn adaptation(from: [f32; 2], to: [f32; 2]) -> DMat3 {
    if (from[0] - to[0]).abs() <= SAME && (from[1] - to[1]).abs() <= SAME {
        return DMat3::IDENTITY;
    }
    let cones = DMat3::from_cols_array(&[
        0.8951, -0.7502, 0.0389, //
        0.2664, 1.7135, -0.0685, //
        -0.1614, 0.0367, 1.0296,
    ]);
    cones.inverse() * DMat3::from_diagonal((cones * xyz(to)) / (cones * xyz(from))) * cones
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_compare::worst;

    fn named(name: &str) -> ToRec709 {
        let (_, from) = NAMED.iter().find(|(n, _)| n.starts_with(name)).unwrap();
        ToRec709::of(*from).unwrap().unwrap()
    }

    /// Largest difference between the matrix of `conversion` and its published rows.
    fn off(conversion: &ToRec709, rows: [[f64; 3]; 3]) -> f64 {
        let columns = DMat3::from_cols_array_2d(&rows).transpose();
        let differences = (conversion.matrix - columns).to_cols_array();
        worst(differences.map(f64::abs))
    }

    /// Published by the Academy (ACES 1.3, AP1 to Rec.709 with Bradford's adaptation) and in ITU-R BT.2087-0.
    const ACESCG: [[f64; 3]; 3] =
        [[1.70505, -0.62179, -0.08326], [-0.13026, 1.14080, -0.01055], [-0.02400, -0.12897, 1.15297]];
    const REC2020: [[f64; 3]; 3] =
        [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]];

    #[test]
    fn matrices_of_acescg_and_rec2020_are_the_published_ones() {
        assert!(off(&named("ACEScg"), ACESCG) < 1e-4, "{}", off(&named("ACEScg"), ACESCG));
        assert!(off(&named("Rec.2020"), REC2020) < 1e-4, "{}", off(&named("Rec.2020"), REC2020));
        assert!(off(&named("Rec.2020"), ACESCG) > 1e-2, "the control");
    }

    #[test]
    fn white_stays_white_for_all_primaries() {
        for (name, from) in NAMED {
            let white = ToRec709::of(from).unwrap().unwrap().apply([1.0; 3]);
            assert!(white.iter().all(|v| (v - 1.0).abs() < 1e-4), "{name}: {white:?}");
        }
        let red = named("ACEScg").apply([1.0, 0.0, 0.0]);
        assert!(red[0] > 1.5 && red[1] < -0.1, "the control: {red:?}");
    }

    #[test]
    fn rec709_needs_no_conversion_and_nonsense_is_refused() {
        assert_eq!(ToRec709::of(REC709), Ok(None));
        let precise = [[0.64, 0.33], [0.3, 0.6], [0.15, 0.06], [0.312_713, 0.329_016]];
        assert_eq!(ToRec709::of(precise), Ok(None), "the same white with more digits");
        let [red, green, blue, _] = REC709;
        for nonsense in [
            [[0.0; 2]; 4],
            [[f32::NAN; 2]; 4],
            [red, red, blue, [0.3127, 0.329]],
            [red, green, blue, [0.3127, 0.0]],
        ] {
            assert_eq!(ToRec709::of(nonsense), Err(UnusableChromaticities), "{nonsense:?}");
        }
    }

    #[test]
    fn rounding_below_zero_becomes_zero_and_nan_stays() {
        let red = named("ACEScg").apply([0.613, 0.070, 0.021]);
        assert!((red[0] - 1.0).abs() < 1e-3 && red[1] >= 0.0 && red[2] >= 0.0, "{red:?}");
        assert!(named("ACEScg").apply([f32::NAN, 0.0, 0.0]).iter().all(|v| v.is_nan()));
    }
}
