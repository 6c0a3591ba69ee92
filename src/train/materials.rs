//! Material start: albedo prototypes from the colours the radiance warm-up found.

use crate::engine::cpu::{linear_from_srgb, sigmoid};
use crate::scene::{Field, Model};

/// Rounds of k-means.
const ROUNDS: usize = 12;
/// Sharpness of the first prototype scores, per squared linear colour distance.
const SHARPNESS: f32 = 60.0;

fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|c| (a[c] - b[c]).powi(2)).sum()
}

/// Sets prototypes to the k-means centres of the Gaussians' view-independent colours, scores and residuals to match.
///
/// Under a light of irradiance pi (see the exposure term) a diffuse surface's colour is its albedo.
pub fn initialise(model: &mut Model) {
    let g = &model.gaussians;
    let colour = |i: usize| -> [f32; 3] {
        let s = g.row(Field::Radiance, i);
        std::array::from_fn(|c| linear_from_srgb((0.5 + 0.282_094_8 * s[c]).clamp(0.0, 1.0)).clamp(0.02, 0.9))
    };
    let points: Vec<([f32; 3], f32)> =
        (0..g.len()).map(|i| (colour(i), sigmoid(g.row(Field::OpacityLogit, i)[0]))).collect();
    if points.is_empty() {
        return;
    }
    let centres = k_means(&points, model.prototypes.len());
    for (i, (c, _)) in points.iter().enumerate() {
        for (score, centre) in model.gaussians.row_mut(Field::ProtoLogits, i).iter_mut().zip(&centres) {
            *score = -SHARPNESS * distance(*c, *centre);
        }
    }
    model.prototypes = centres;
}

/// Farthest-first start, then Lloyd's rounds: no random draw.
fn k_means(points: &[([f32; 3], f32)], k: usize) -> Vec<[f32; 3]> {
    let mut centres = vec![points[0].0];
    let mut nearest: Vec<f32> = points.iter().map(|(p, _)| distance(*p, centres[0])).collect();
    while centres.len() < k {
        let score = |i: &usize| nearest[*i] * points[*i].1;
        let next = (0..points.len()).max_by(|a, b| score(a).total_cmp(&score(b))).unwrap_or(0);
        centres.push(points[next].0);
        for (n, (p, _)) in nearest.iter_mut().zip(points) {
            *n = n.min(distance(*p, points[next].0));
        }
    }
    for _ in 0..ROUNDS {
        let mut sums = vec![([0.0f64; 3], 0.0f64); k];
        for (p, w) in points {
            let best = (0..k).min_by(|a, b| distance(*p, centres[*a]).total_cmp(&distance(*p, centres[*b])));
            let (sum, weight) = &mut sums[best.unwrap_or(0)];
            (0..3).for_each(|c| sum[c] += f64::from(p[c] * w));
            *weight += f64::from(*w);
        }
        for (centre, (sum, weight)) in centres.iter_mut().zip(sums) {
            if weight > 0.0 {
                *centre = sum.map(|s| (s / weight) as f32);
            }
        }
    }
    centres
}
