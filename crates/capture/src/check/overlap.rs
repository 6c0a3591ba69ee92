//! Estimates the overlap of photographs from thumbnails, at a small fraction of the cost of feature matching.

use rayon::prelude::*;

use crate::sharpness::luma;
use relume_scene::ImageRgba;

/// Side of a thumbnail, pixels, for any aspect ratio of the photograph.
const SIDE: usize = 24;
/// Greatest shift of two thumbnails against each other, pixels.
const REACH: isize = 8;
/// Each photograph is compared with at most this many before and after it, by name.
const NEIGHBOURS: usize = 250;

/// Luma, row-major, [`SIDE`] x [`SIDE`].
pub(super) struct Thumbnail(Vec<f32>);

impl Thumbnail {
    pub(super) fn of(image: &ImageRgba) -> Self {
        let small = image.resized(SIDE as u32, SIDE as u32).shown();
        Self(small.pixels.iter().map(|pixel| luma(pixel) as f32).collect())
    }
}

/// For each thumbnail the largest similarity to any other; 0 for a single thumbnail.
pub(super) fn with_nearest(thumbnails: &[Thumbnail]) -> Vec<f64> {
    let nearest = |i: usize| {
        let others = i.saturating_sub(NEIGHBOURS)..(i + NEIGHBOURS + 1).min(thumbnails.len());
        let others = others.filter(|j| *j != i);
        others.map(|j| similarity(&thumbnails[i], &thumbnails[j])).reduce(f64::max).unwrap_or(0.0)
    };
    (0..thumbnails.len()).into_par_iter().map(nearest).collect()
}

/// The correlation of the overlapping parts of two thumbnails at the shift that maximises it; 1 for equal thumbnails.
fn similarity(a: &Thumbnail, b: &Thumbnail) -> f64 {
    let shifts = (-REACH..=REACH).step_by(2);
    let pairs = shifts.clone().flat_map(|y| shifts.clone().map(move |x| (x, y)));
    pairs.map(|shift| correlation(&a.0, &b.0, shift)).fold(-1.0, f64::max)
}

fn correlation(a: &[f32], b: &[f32], (dx, dy): (isize, isize)) -> f64 {
    let common = |shift: isize| shift.max(0) as usize..(SIDE as isize + shift.min(0)) as usize;
    let (mut n, mut sums, mut squares, mut product) = (0.0, [0.0; 2], [0.0; 2], 0.0);
    for y in common(dy) {
        for x in common(dx) {
            let (u, v) = (x.wrapping_add_signed(-dx), y.wrapping_add_signed(-dy));
            let pair = [f64::from(a[y * SIDE + x]), f64::from(b[v * SIDE + u])];
            n += 1.0;
            product += pair[0] * pair[1];
            (0..2).for_each(|k| {
                sums[k] += pair[k];
                squares[k] += pair[k] * pair[k];
            });
        }
    }
    let [va, vb] = [0, 1].map(|k: usize| squares[k] / n - (sums[k] / n).powi(2));
    let covariance = product / n - sums[0] / n * (sums[1] / n);
    let scale = (va * vb).sqrt();
    // Thumbnails without contrast give no information.
    if scale > 1e-9 { covariance / scale } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A window of a field of smooth bumps, from `left` on.
    fn window(left: usize, seed: usize) -> Thumbnail {
        let bump = |x: usize, y: usize| {
            let (x, y) = ((x + left) as f32, y as f32);
            let wave = |k: usize| ((seed * 7 + k * 13) % 11) as f32 * 0.06 + 0.1;
            (x * wave(1) + y * wave(2)).sin() + (x * wave(3) - y * wave(4)).cos()
        };
        Thumbnail((0..SIDE * SIDE).map(|i| bump(i % SIDE, i / SIDE)).collect())
    }

    #[test]
    fn shifted_thumbnails_are_similar_and_other_scenes_are_not() {
        let (here, shifted, other) = (window(0, 1), window(6, 1), window(0, 5));
        assert!(similarity(&here, &here) > 0.999_999);
        assert!(similarity(&here, &shifted) > 0.99, "{}", similarity(&here, &shifted));
        assert!(similarity(&here, &other) < 0.9, "{}", similarity(&here, &other));
        assert_eq!(similarity(&here, &Thumbnail(vec![0.5; SIDE * SIDE])), 0.0);
        let nearest = with_nearest(&[here, shifted, other]);
        assert!(nearest[0] > 0.99 && nearest[1] > 0.99 && nearest[2] < 0.9, "{nearest:?}");
        assert_eq!(with_nearest(&[window(0, 1)]), [0.0]);
    }
}
