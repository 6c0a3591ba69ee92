//! Reference colours of the 24 patches of the classic colour chart.

use glam::{DMat3, DVec3};

use relume_spec::training::ChartEdition;

/// Columns of patches.
pub(super) const COLUMNS: usize = 6;
/// Rows of patches.
pub(super) const ROWS: usize = 4;
/// Patches.
pub(super) const PATCHES: usize = COLUMNS * ROWS;
/// Index of the first of the six neutral patches, white to black.
pub(super) const FIRST_NEUTRAL: usize = 18;

/// Names of the patches, row by row from the corner of the dark skin patch.
pub(super) const NAMES: [&str; PATCHES] = [
    "dark skin",
    "light skin",
    "blue sky",
    "foliage",
    "blue flower",
    "bluish green",
    "orange",
    "purplish blue",
    "moderate red",
    "purple",
    "yellow green",
    "orange yellow",
    "blue",
    "green",
    "red",
    "yellow",
    "magenta",
    "cyan",
    "white",
    "neutral 8",
    "neutral 6.5",
    "neutral 5",
    "neutral 3.5",
    "black",
];

/// CIE L*a*b*, illuminant D50, 2 degree observer. Source: X-Rite, "ColorChecker Classic", reference data of charts that were made since
/// November 2014 (measured with an i1Pro 2, condition M0).
const SINCE_2014: [[f64; 3]; PATCHES] = [
    [37.54, 14.37, 14.92],
    [64.66, 19.27, 17.50],
    [49.32, -3.82, -22.54],
    [43.46, -12.74, 22.72],
    [54.94, 9.61, -24.79],
    [70.48, -32.26, -0.37],
    [62.73, 35.83, 56.50],
    [39.43, 10.75, -45.17],
    [50.57, 48.64, 16.67],
    [30.10, 22.54, -20.87],
    [71.77, -24.13, 58.19],
    [71.51, 18.24, 67.37],
    [28.37, 15.42, -49.80],
    [54.38, -39.72, 32.27],
    [42.43, 51.05, 28.62],
    [81.80, 2.67, 80.41],
    [50.63, 51.28, -14.12],
    [49.57, -29.71, -28.32],
    [95.19, -1.03, 2.93],
    [81.29, -0.57, 0.44],
    [66.89, -0.75, -0.06],
    [50.76, -0.13, 0.14],
    [35.63, -0.46, -0.48],
    [20.64, 0.07, -0.46],
];

/// As [`SINCE_2014`], for charts that were made before November 2014. Source: X-Rite, "Colorimetric values for ColorChecker family of
/// targets", reference data of 2005.
const BEFORE_2014: [[f64; 3]; PATCHES] = [
    [37.986, 13.555, 14.059],
    [65.711, 18.130, 17.810],
    [49.927, -4.880, -21.925],
    [43.139, -13.095, 21.905],
    [55.112, 8.844, -25.399],
    [70.719, -33.397, -0.199],
    [62.661, 36.067, 57.096],
    [40.020, 10.410, -45.964],
    [51.124, 48.239, 16.248],
    [30.325, 22.976, -21.587],
    [72.532, -23.709, 57.255],
    [71.941, 19.363, 67.857],
    [28.778, 14.179, -50.297],
    [55.261, -38.342, 31.370],
    [42.101, 53.378, 28.190],
    [81.733, 4.039, 79.819],
    [51.935, 49.986, -14.574],
    [51.038, -28.631, -28.638],
    [96.539, -0.425, 1.186],
    [81.257, -0.638, -0.335],
    [66.766, -0.734, -0.504],
    [50.867, -0.153, -0.270],
    [35.656, -0.421, -1.231],
    [20.461, -0.079, -0.973],
];

/// The white D50 of the ICC profile connection space, CIE XYZ.
const D50: DVec3 = DVec3::new(0.964_22, 1.0, 0.825_21);

/// CIE XYZ relative to D50 to linear Rec.709 (white D65), with Bradford's adaptation; columns. The rows are those of ICC.1:2022, annex E,
/// applied to the primaries of ITU-R BT.709.
const XYZ_TO_REC709: DMat3 = DMat3::from_cols(
    DVec3::new(3.133_856_1, -0.978_768_4, 0.071_945_3),
    DVec3::new(-1.616_866_7, 1.916_141_5, -0.228_991_4),
    DVec3::new(-0.490_614_6, 0.033_454_0, 1.405_242_7),
);

/// CIE L*a*b* of the patches, D50.
pub(super) fn lab_of(edition: ChartEdition) -> &'static [[f64; 3]; PATCHES] {
    match edition {
        ChartEdition::SinceNovember2014 => &SINCE_2014,
        ChartEdition::BeforeNovember2014 => &BEFORE_2014,
    }
}

/// Linear Rec.709 reflectance of the patches. Cyan lies outside of Rec.709 and has a negative red.
pub(super) fn reflectances(edition: ChartEdition) -> [DVec3; PATCHES] {
    lab_of(edition).map(rec709_of_lab)
}

/// Linear Rec.709 of a CIE L*a*b* colour relative to D50 (CIE 15:2004, section 8.2.1).
pub(super) fn rec709_of_lab([l, a, b]: [f64; 3]) -> DVec3 {
    let fy = (l + 16.0) / 116.0;
    let inverse =
        |f: f64| if f > 6.0 / 29.0 { f.powi(3) } else { 3.0 * (6.0f64 / 29.0).powi(2) * (f - 4.0 / 29.0) };
    XYZ_TO_REC709 * (D50 * DVec3::new(inverse(fy + a / 500.0), inverse(fy), inverse(fy - b / 200.0)))
}

/// CIE L*a*b* relative to D50 of a linear Rec.709 colour.
pub(super) fn lab_of_rec709(rgb: DVec3) -> [f64; 3] {
    let xyz = XYZ_TO_REC709.inverse() * rgb / D50;
    let f = |t: f64| {
        if t > (6.0f64 / 29.0).powi(3) { t.cbrt() } else { t / (3.0 * (6.0f64 / 29.0).powi(2)) + 4.0 / 29.0 }
    };
    let [x, y, z] = xyz.to_array().map(f);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::chromaticities::ToRec709;
    use relume_compare::largest_difference;
    use relume_fixtures::colour_chart::SRGB;
    use relume_scene::srgb;

    #[test]
    fn reference_colours_are_near_their_published_srgb_values() {
        let encoded = |edition| {
            reflectances(edition)
                .map(|c| c.to_array().map(|v| f64::from(srgb::encode(v.max(0.0) as f32)) * 255.0))
        };
        let off = |a: &[[f64; 3]], b: &[[f64; 3]]| largest_difference(a.as_flattened(), b.as_flattened());
        let published = SRGB.map(|c| c.map(f64::from));
        let old = encoded(ChartEdition::BeforeNovember2014);
        // The published values were not adapted with Bradford's method, so saturated colours differ.
        assert!(off(&old, &published) < 22.0, "{}", off(&old, &published));
        let (neutral, wanted) = (&old[FIRST_NEUTRAL..], &published[FIRST_NEUTRAL..]);
        assert!(off(neutral, wanted) < 4.0, "{}", off(neutral, wanted));
        let new = encoded(ChartEdition::SinceNovember2014);
        let between = off(&new, &old);
        assert!(between > 2.0 && between < 25.0, "the editions differ a little: {between}");
        let mut shifted = published;
        shifted.rotate_left(1);
        assert!(off(&old, &shifted) > 50.0, "the control: the next patch");
    }

    #[test]
    fn white_of_d50_is_white_and_lab_round_trips() {
        assert!(largest_difference(&rec709_of_lab([100.0, 0.0, 0.0]).to_array(), &[1.0; 3]) < 1e-5);
        for lab in SINCE_2014.iter().chain(&BEFORE_2014).chain(&[[3.0, 1.0, -2.0], [0.0; 3]]) {
            assert!(largest_difference(&lab_of_rec709(rec709_of_lab(*lab)), lab) < 1e-8, "{lab:?}");
        }
        let grey = rec709_of_lab([50.0, 20.0, 0.0]);
        assert!(grey.x - grey.y > 0.05, "the control: {grey}");
    }

    #[test]
    fn matrix_is_that_of_the_primaries_and_of_bradford() {
        // The primaries are the axes of XYZ, scaled to the white D50.
        let xyz = [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0], [0.345_67, 0.358_5]];
        let conversion = ToRec709::of(xyz).unwrap().unwrap();
        let wanted = (XYZ_TO_REC709 * DMat3::from_diagonal(D50)).to_cols_array_2d();
        let found = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| conversion.apply(axis));
        let off = |found: &[[f32; 3]; 3]| largest_difference(found.as_flattened(), wanted.as_flattened());
        assert!(off(&found) < 2e-3, "{found:?} {wanted:?}");
        let [x, y, z] = found;
        assert!(off(&[y, x, z]) > 1.0, "the control");
    }
}
