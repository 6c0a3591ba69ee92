//! The colour difference CIEDE2000.

use crate::colour_chart::reference::lab_of_rec709;
use glam::DVec3;

/// Mean and maximum of CIEDE2000 over patches of a chart.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct DeltaE {
    /// Mean over the patches.
    pub mean: f64,
    /// The largest one.
    pub max: f64,
}

impl DeltaE {
    /// Over pairs of linear Rec.709 colours, which are compared relative to D50. `None` without pairs.
    pub fn of(pairs: impl IntoIterator<Item = (DVec3, DVec3)>) -> Option<Self> {
        let (mut sum, mut max, mut count) = (0.0, 0.0, 0usize);
        for (a, b) in pairs {
            let difference = ciede2000(lab_of_rec709(a), lab_of_rec709(b));
            (sum, count) = (sum + difference, count + 1);
            // NaN is the largest difference.
            max = if difference > max || difference.is_nan() { difference } else { max };
        }
        (count > 0).then(|| Self { mean: sum / count as f64, max })
    }
}

/// CIEDE2000 of two CIE L*a*b* colours with the weights k = 1 (CIE 142-2001; the notation is that of G. Sharma, W. Wu, E. N. Dalal, "The
/// CIEDE2000 color-difference formula: implementation notes, supplementary test data, and mathematical observations", Color Research and
/// Application 30, 2005, equations 2 to 22).
pub(super) fn ciede2000([l1, a1, b1]: [f64; 3], [l2, a2, b2]: [f64; 3]) -> f64 {
    let share = |chroma: f64| (chroma.powi(7) / (chroma.powi(7) + 25.0f64.powi(7))).sqrt();
    let g = 0.5 * (1.0 - share(0.5 * (a1.hypot(b1) + a2.hypot(b2))));
    let (a1, a2) = ((1.0 + g) * a1, (1.0 + g) * a2);
    let (c1, c2) = (a1.hypot(b1), a2.hypot(b2));
    let hue =
        |a: f64, b: f64| if a == 0.0 && b == 0.0 { 0.0 } else { b.atan2(a).to_degrees().rem_euclid(360.0) };
    let (h1, h2) = (hue(a1, b1), hue(a2, b2));
    let has_hues = c1 * c2 != 0.0;
    let turn = match h2 - h1 {
        _ if !has_hues => 0.0,
        apart if apart > 180.0 => apart - 360.0,
        apart if apart < -180.0 => apart + 360.0,
        apart => apart,
    };
    let (dl, dc) = (l2 - l1, c2 - c1);
    let dh = 2.0 * (c1 * c2).sqrt() * (0.5 * turn).to_radians().sin();
    let (l, c) = (0.5 * (l1 + l2), 0.5 * (c1 + c2));
    let h = match h1 + h2 {
        sum if !has_hues => sum,
        sum if (h1 - h2).abs() <= 180.0 => 0.5 * sum,
        sum if sum < 360.0 => 0.5 * (sum + 360.0),
        sum => 0.5 * (sum - 360.0),
    };
    let cos = |degrees: f64| degrees.to_radians().cos();
    let t = 1.0 - 0.17 * cos(h - 30.0) + 0.24 * cos(2.0 * h) + 0.32 * cos(3.0 * h + 6.0)
        - 0.2 * cos(4.0 * h - 63.0);
    let from_50 = (l - 50.0).powi(2);
    let (sl, sc, sh) =
        (1.0 + 0.015 * from_50 / (20.0 + from_50).sqrt(), 1.0 + 0.045 * c, 1.0 + 0.015 * c * t);
    let rotation = 60.0 * (-((h - 275.0) / 25.0).powi(2)).exp();
    let rt = -2.0 * share(c) * rotation.to_radians().sin();
    let (dl, dc, dh) = (dl / sl, dc / sc, dh / sh);
    let square = dl * dl + dc * dc + dh * dh + rt * dc * dh;
    // Rounding may make it negative; NaN is kept.
    if square <= 0.0 { 0.0 } else { square.sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pairs and differences of table 1 of Sharma, Wu and Dalal 2005.
    const PAIRS: [([f64; 3], [f64; 3], f64); 34] = [
        ([50.0, 2.6772, -79.7751], [50.0, 0.0, -82.7485], 2.0425),
        ([50.0, 3.1571, -77.2803], [50.0, 0.0, -82.7485], 2.8615),
        ([50.0, 2.8361, -74.0200], [50.0, 0.0, -82.7485], 3.4412),
        ([50.0, -1.3802, -84.2814], [50.0, 0.0, -82.7485], 1.0000),
        ([50.0, -1.1848, -84.8006], [50.0, 0.0, -82.7485], 1.0000),
        ([50.0, -0.9009, -85.5211], [50.0, 0.0, -82.7485], 1.0000),
        ([50.0, 0.0, 0.0], [50.0, -1.0, 2.0], 2.3669),
        ([50.0, -1.0, 2.0], [50.0, 0.0, 0.0], 2.3669),
        ([50.0, 2.4900, -0.0010], [50.0, -2.4900, 0.0009], 7.1792),
        ([50.0, 2.4900, -0.0010], [50.0, -2.4900, 0.0010], 7.1792),
        ([50.0, 2.4900, -0.0010], [50.0, -2.4900, 0.0011], 7.2195),
        ([50.0, 2.4900, -0.0010], [50.0, -2.4900, 0.0012], 7.2195),
        ([50.0, -0.0010, 2.4900], [50.0, 0.0009, -2.4900], 4.8045),
        ([50.0, -0.0010, 2.4900], [50.0, 0.0010, -2.4900], 4.8045),
        ([50.0, -0.0010, 2.4900], [50.0, 0.0011, -2.4900], 4.7461),
        ([50.0, 2.5, 0.0], [50.0, 0.0, -2.5], 4.3065),
        ([50.0, 2.5, 0.0], [73.0, 25.0, -18.0], 27.1492),
        ([50.0, 2.5, 0.0], [61.0, -5.0, 29.0], 22.8977),
        ([50.0, 2.5, 0.0], [56.0, -27.0, -3.0], 31.9030),
        ([50.0, 2.5, 0.0], [58.0, 24.0, 15.0], 19.4535),
        ([50.0, 2.5, 0.0], [50.0, 3.1736, 0.5854], 1.0000),
        ([50.0, 2.5, 0.0], [50.0, 3.2972, 0.0], 1.0000),
        ([50.0, 2.5, 0.0], [50.0, 1.8634, 0.5757], 1.0000),
        ([50.0, 2.5, 0.0], [50.0, 3.2592, 0.3350], 1.0000),
        ([60.2574, -34.0099, 36.2677], [60.4626, -34.1751, 39.4387], 1.2644),
        ([63.0109, -31.0961, -5.8663], [62.8187, -29.7946, -4.0864], 1.2630),
        ([61.2901, 3.7196, -5.3901], [61.4292, 2.2480, -4.9620], 1.8731),
        ([35.0831, -44.1164, 3.7933], [35.0232, -40.0716, 1.5901], 1.8645),
        ([22.7233, 20.0904, -46.6940], [23.0331, 14.9730, -42.5619], 2.0373),
        ([36.4612, 47.8580, 18.3852], [36.2715, 50.5065, 21.2231], 1.4146),
        ([90.8027, -2.0831, 1.4410], [91.1528, -1.6435, 0.0447], 1.4441),
        ([90.9257, -0.5406, -0.9208], [88.6381, -0.8985, -0.7239], 1.5381),
        ([6.7747, -0.2908, -2.4247], [5.8714, -0.0985, -2.2286], 0.6377),
        ([2.0776, 0.0795, -1.1350], [0.9033, -0.0636, -0.5514], 0.9082),
    ];

    #[test]
    fn ciede2000_matches_the_published_pairs_both_ways() {
        for (a, b, wanted) in PAIRS {
            for found in [ciede2000(a, b), ciede2000(b, a)] {
                assert!((found - wanted).abs() < 1e-4, "{a:?} {b:?}: {found}, not {wanted}");
            }
            assert!(ciede2000(a, a) == 0.0);
        }
        let euclidean = |a: [f64; 3], b: [f64; 3]| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
        let plain = PAIRS.iter().filter(|(a, b, wanted)| (euclidean(*a, *b) - wanted).abs() < 1e-4);
        assert!(plain.count() < 3, "the control: CIE 1976");
    }

    #[test]
    fn mean_and_maximum_over_pairs_keep_nan() {
        let (grey, white) = (DVec3::splat(0.18), DVec3::ONE);
        let both = DeltaE::of([(grey, grey), (grey, white)]).unwrap();
        assert!(both.max > 30.0 && (both.mean - 0.5 * both.max).abs() < 1e-9, "{both:?}");
        let nan = DeltaE::of([(grey, white), (DVec3::NAN, white), (grey, grey)]).unwrap();
        assert!(nan.mean.is_nan());
        assert_eq!(DeltaE::of([]), None);
    }
}
