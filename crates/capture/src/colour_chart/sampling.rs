//! The colours of the patches of a chart in a photograph.

use glam::{DMat3, DVec2, DVec3};

use crate::colour_chart::matrix::{is_clipped, linear};
use crate::colour_chart::reference::{COLUMNS, PATCHES, ROWS};
use relume_scene::{DisplayRange, ImageRgba};

/// Distance of two patches over their size, in a chart whose corner patches end at its corners. Charts have 0.1 to 0.2; the sampled part
/// of each patch lies within it for any distance up to 0.25.
const GAP: f64 = 0.13;
/// Sampled part of a patch, of its width and of its height.
const SAMPLED: f64 = 0.5;
/// Least number of pixels of the sampled part.
const MIN_PIXELS: usize = 4;
/// Largest share of sampled pixels at an end of the range of the photograph.
const MAX_CLIPPED_SHARE: f64 = 0.05;
/// Largest mean of a channel over the peak of the range; as for grey cards.
const MAX_VALUE: f64 = 0.98;
/// Least mean of the brightest channel, linear; as for grey cards.
const MIN_VALUE: f64 = 0.01;
/// Least mean alpha of a patch.
const MIN_ALPHA: f64 = 0.5;

/// Why a patch has no colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum LeftOut {
    /// A channel is at an end of its range.
    Clipped,
    /// All channels are dark.
    Dark,
    /// The photograph is transparent there.
    Hidden,
    /// The sampled part has too few pixels.
    Small,
}

impl LeftOut {
    /// The reason in words.
    pub(super) fn reason(self) -> &'static str {
        match self {
            Self::Clipped => "clipped",
            Self::Dark => "too dark",
            Self::Hidden => "hidden by the mask",
            Self::Small => "too small",
        }
    }
}

/// The map from the unit square to the quadrilateral with these corners: (0, 0), (1, 0), (1, 1) and (0, 1), in this order. `None` for
/// corners that determine no such map (P. Heckbert, "Fundamentals of texture mapping and image warping", 1989, section 2.2.3).
pub(super) fn homography(corners: [DVec2; 4]) -> Option<DMat3> {
    let [a, b, c, d] = corners;
    let (right, down, sum) = (b - c, d - c, a - b + c - d);
    let denominator = right.perp_dot(down);
    let g = sum.perp_dot(down) / denominator;
    let h = right.perp_dot(sum) / denominator;
    let x = DVec3::new(b.x - a.x + g * b.x, b.y - a.y + g * b.y, g);
    let y = DVec3::new(d.x - a.x + h * d.x, d.y - a.y + h * d.y, h);
    let map = DMat3::from_cols(x, y, DVec3::new(a.x, a.y, 1.0));
    (map.is_finite() && map.determinant().abs() > 1e-9).then_some(map)
}

/// A point of the unit square in the quadrilateral.
pub(super) fn mapped(map: &DMat3, point: DVec2) -> DVec2 {
    let p = *map * point.extend(1.0);
    p.truncate() / p.z
}

/// The sampled part of patch `index` in the unit square: its least and its greatest corner.
pub(super) fn sampled_part(index: usize) -> (DVec2, DVec2) {
    let count = DVec2::new(COLUMNS as f64, ROWS as f64);
    let size = 1.0 / (count + GAP * (count - 1.0));
    let cell = DVec2::new((index % COLUMNS) as f64, (index / COLUMNS) as f64);
    let centre = (cell * (1.0 + GAP) + 0.5) * size;
    (centre - 0.5 * SAMPLED * size, centre + 0.5 * SAMPLED * size)
}

/// The corners of the sampled part of patch `index` in the photograph.
pub(super) fn corners_of_patch(map: &DMat3, index: usize) -> [DVec2; 4] {
    let (low, high) = sampled_part(index);
    [low, DVec2::new(high.x, low.y), high, DVec2::new(low.x, high.y)].map(|corner| mapped(map, corner))
}

/// Mean linear colours of the patches of the chart that `map` maps to `photograph`, weighted with alpha.
pub(super) fn colours(
    photograph: &ImageRgba,
    range: DisplayRange,
    map: &DMat3,
) -> [Result<DVec3, LeftOut>; PATCHES] {
    std::array::from_fn(|index| colour(photograph, range, map, index))
}

fn colour(photograph: &ImageRgba, range: DisplayRange, map: &DMat3, index: usize) -> Result<DVec3, LeftOut> {
    let inverse = map.inverse();
    let (low, high) = sampled_part(index);
    let corners = corners_of_patch(map, index);
    let first = corners.iter().fold(DVec2::INFINITY, |a, b| a.min(*b)).floor().max(DVec2::ZERO);
    let last = corners.iter().fold(DVec2::NEG_INFINITY, |a, b| a.max(*b)).ceil();
    let last = last.min(DVec2::new(f64::from(photograph.width), f64::from(photograph.height)));
    let (mut sum, mut weight, mut pixels, mut clipped) = (DVec3::ZERO, 0.0f64, 0usize, 0usize);
    for row in first.y as usize..last.y as usize {
        for column in first.x as usize..last.x as usize {
            let at = mapped(&inverse, DVec2::new(column as f64 + 0.5, row as f64 + 0.5));
            if !(at.cmpge(low).all() && at.cmple(high).all()) {
                continue;
            }
            let [r, g, b, alpha] = photograph.pixels[row * photograph.width as usize + column];
            let is_at_end = [r, g, b].iter().any(|v| !(*v > 0.0) || is_clipped(*v, range));
            let colour = [r, g, b].map(|v| f64::from(linear(v)));
            (pixels, clipped) = (pixels + 1, clipped + usize::from(is_at_end && alpha > 0.0));
            sum += f64::from(alpha) * DVec3::from(colour);
            weight += f64::from(alpha);
        }
    }
    let mean = sum / weight;
    match () {
        () if pixels < MIN_PIXELS => Err(LeftOut::Small),
        () if !(weight >= MIN_ALPHA * pixels as f64) => Err(LeftOut::Hidden),
        // A dark patch may be clipped at 0 in each channel.
        () if !(mean.max_element() >= MIN_VALUE) => Err(LeftOut::Dark),
        () if clipped as f64 > MAX_CLIPPED_SHARE * pixels as f64 => Err(LeftOut::Clipped),
        () if !(mean.max_element() <= MAX_VALUE * f64::from(range.peak())) => Err(LeftOut::Clipped),
        () => Ok(mean),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::colour_chart::test_chart::{self, CORNERS};

    fn close(a: DVec2, b: DVec2) -> bool {
        (a - b).length() < 1e-9
    }

    #[test]
    fn homography_maps_the_corners_and_its_inverse_returns() {
        let map = homography(CORNERS).unwrap();
        let unit = [DVec2::ZERO, DVec2::X, DVec2::ONE, DVec2::Y];
        for (point, corner) in unit.into_iter().zip(CORNERS) {
            assert!(close(mapped(&map, point), corner), "{point}");
            assert!((mapped(&map.inverse(), corner) - point).length() < 1e-9);
        }
        let middle = CORNERS.iter().sum::<DVec2>() / 4.0;
        assert!(!close(mapped(&map, DVec2::splat(0.5)), middle), "the control: perspective");
        // The diagonals of the square meet where those of the quadrilateral do.
        let [a, b, c, d] = CORNERS;
        let centre = mapped(&map, DVec2::splat(0.5));
        assert!((centre - a).perp_dot(c - a).abs() < 1e-6 && (centre - b).perp_dot(d - b).abs() < 1e-6);
        assert_eq!(homography([a, a, a, a]), None);
    }

    #[test]
    fn each_patch_is_sampled_within_it_for_other_gaps_and_frames() {
        for gap in [0.0, 0.1, 0.2, 0.25] {
            for frame in [0.0, 0.15] {
                let side = |n: f64| n + gap * (n - 1.0) + 2.0 * frame;
                let size = DVec2::new(side(6.0), side(4.0));
                for index in 0..PATCHES {
                    let cell = DVec2::new((index % COLUMNS) as f64, (index / COLUMNS) as f64);
                    let start = frame + cell * (1.0 + gap);
                    let (low, high) = sampled_part(index);
                    let (low, high) = (low * size - start, high * size - start);
                    assert!(
                        low.min_element() > 0.0 && high.max_element() < 1.0,
                        "{gap} {frame} {index}: {low} {high}"
                    );
                }
            }
        }
    }

    #[test]
    fn colours_are_linear_means_of_the_patches_only() {
        let wanted = |index: usize| DVec3::new(0.1 + 0.03 * index as f64, 0.5, 0.8 - 0.03 * index as f64);
        let mut photograph = test_chart::photograph(CORNERS, wanted);
        let map = homography(CORNERS).unwrap();
        let found = |photograph: &ImageRgba| colours(photograph, DisplayRange::Unit, &map);
        for (index, found) in found(&photograph).into_iter().enumerate() {
            assert!((found.unwrap() - wanted(index)).length() < 1e-4, "{index}");
            assert!((found.unwrap() - wanted((index + 1) % PATCHES)).length() > 0.02, "the control");
        }
        // Transparent pixels do not count, whatever their colour.
        let [x, y] =
            mapped(&map, DVec2::splat(0.5) * sampled_part(0).0 + 0.5 * sampled_part(0).1).floor().to_array();
        let [x, y] = [x as usize, y as usize];
        photograph.pixels[y * photograph.width as usize + x] = [1.0, 1.0, 1.0, 0.0];
        assert!((found(&photograph)[0].unwrap() - wanted(0)).length() < 1e-4);
    }

    #[test]
    fn patches_without_a_usable_colour_are_left_out() {
        let map = homography(CORNERS).unwrap();
        let of = |colour: DVec3, range: DisplayRange| {
            colours(&test_chart::photograph(CORNERS, |_| colour), range, &map)[3]
        };
        let unit = DisplayRange::Unit;
        assert_eq!(of(DVec3::new(1.0, 0.5, 0.5), unit), Err(LeftOut::Clipped));
        assert_eq!(of(DVec3::new(0.99, 0.5, 0.5), unit), Err(LeftOut::Clipped));
        assert_eq!(of(DVec3::new(0.0, 0.5, 0.5), unit), Err(LeftOut::Clipped));
        assert_eq!(of(DVec3::splat(0.005), unit), Err(LeftOut::Dark));
        assert!(of(DVec3::new(0.97, 0.5, 0.002), unit).is_ok(), "the control");
        assert!(of(DVec3::new(1.0, 0.5, 0.5), DisplayRange::Extended).is_ok(), "no clip in linear light");
        let mut hidden = test_chart::photograph(CORNERS, |_| DVec3::splat(0.5));
        hidden.pixels.iter_mut().for_each(|p| p[3] = 0.0);
        assert_eq!(colours(&hidden, unit, &map)[0], Err(LeftOut::Hidden));
        let small = homography(CORNERS.map(|c| 20.0 + 0.05 * c)).unwrap();
        let photograph = test_chart::photograph(CORNERS, |_| DVec3::splat(0.5));
        assert_eq!(colours(&photograph, unit, &small)[0], Err(LeftOut::Small));
    }
}
