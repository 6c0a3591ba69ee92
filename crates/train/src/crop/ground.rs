//! Finds the ground under the subject in the geometry after the warm-up.

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use relume_engine::{TrainState, evaluation};
use relume_scene::{Camera, Field};

/// Number of planes that are tested.
const TRIALS: usize = 3_000;
/// Least cosine between a plane's normal and +Z, the up direction of the capture.
const LEVEL: f64 = 0.75;
/// Distance from a plane within which a Gaussian belongs to it, ball radii; early geometry is imprecise.
const THICKNESS: f64 = 0.05;
/// Height above the plane at which the subject starts, ball radii.
const CLEARANCE: f64 = 0.03;
/// Least share of the visible part of the ball that lies on the ground minus that below it, and least share above it.
const MIN_SHARES: [f64; 2] = [0.08, 0.1];
/// Upper bound of a Gaussian's weight relative to the median; a few large Gaussians are haze.
const MAX_WEIGHT_RATIO: f64 = 4.0;

/// Upward unit normal of the ground in the ball, and the height along it below which nothing belongs to the subject;
/// `None` if no level plane contains enough of what `cameras` see.
pub fn find(state: &TrainState, cameras: &[&Camera], centre: DVec3, radius: f64) -> Option<[f64; 4]> {
    plane(&seen(state, cameras, centre, radius), radius)
}

/// Positions in the ball, and the number of pixels that each covers in all photographs together.
fn seen(state: &TrainState, cameras: &[&Camera], centre: DVec3, radius: f64) -> Vec<(DVec3, f64)> {
    let g = &state.model.gaussians;
    let mut pixels = vec![0.0f64; g.len()];
    for camera in cameras {
        let weights = evaluation::blending_weights(state, camera);
        pixels.iter_mut().zip(weights).for_each(|(sum, weight)| *sum += f64::from(weight));
    }
    let at = |i: usize| DVec3::from_array(std::array::from_fn(|k| f64::from(g.row(Field::Mean, i)[k])));
    let points = (0..g.len()).map(|i| (at(i), pixels[i]));
    points.filter(|(p, weight)| *weight > 0.0 && (*p - centre).length() < radius).collect()
}

/// The level plane with the largest share of `points` on it minus that below it, with its clearance; `None` if the
/// shares are too small for a ground. Deterministic.
fn plane(points: &[(DVec3, f64)], radius: f64) -> Option<[f64; 4]> {
    if points.len() < 3 {
        return None;
    }
    let weights = capped(points);
    let thickness = THICKNESS * radius;
    // Shares of the visible part that lie on, above and below a plane.
    let shares = |normal: DVec3, height: f64| {
        let mut sums = [0.0; 3];
        for ((p, _), weight) in points.iter().zip(&weights) {
            let over = normal.dot(*p) - height;
            sums[if over.abs() < thickness { 0 } else { 1 + usize::from(over < 0.0) }] += weight;
        }
        sums
    };
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut best = (f64::NEG_INFINITY, 0.0, [0.0; 4]);
    for _ in 0..TRIALS {
        let [a, b, c]: [DVec3; 3] = std::array::from_fn(|_| points[rng.random_range(0..points.len())].0);
        let across = (b - a).cross(c - a);
        let normal = across.normalize_or_zero() * across.z.signum();
        if normal.z < LEVEL {
            continue;
        }
        let height = normal.dot(a);
        let [on, above, below] = shares(normal, height);
        if on - below > best.0 {
            best = (on - below, above, [normal.x, normal.y, normal.z, height + CLEARANCE * radius]);
        }
    }
    let (carries, above, plane) = best;
    (carries > MIN_SHARES[0] && above > MIN_SHARES[1]).then_some(plane)
}

/// Weights of `points`, capped at [`MAX_WEIGHT_RATIO`] times the median; their sum is 1.
fn capped(points: &[(DVec3, f64)]) -> Vec<f64> {
    let mut sorted: Vec<f64> = points.iter().map(|(_, weight)| *weight).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let most = MAX_WEIGHT_RATIO * sorted[sorted.len() / 2];
    let sum: f64 = sorted.iter().map(|weight| weight.min(most)).sum();
    points.iter().map(|(_, weight)| weight.min(most) / sum).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A disc of radius 1 tilted by `tilt` about the y axis, with or without a post on it.
    fn scene(tilt: f64, post: bool) -> Vec<(DVec3, f64)> {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut at = |range: f64| (rng.random::<f64>() - 0.5) * range;
        let (sin, cos) = tilt.sin_cos();
        let mut points = Vec::new();
        for i in 0..400 {
            let (x, y) = (at(1.6), at(1.2));
            let z = if post && i % 4 == 0 { 0.1 + 0.5 * (i as f64 / 400.0) } else { at(0.02) };
            let (x, y) = if z > 0.05 { (0.1 * x, 0.1 * y) } else { (x, y) };
            points.push((DVec3::new(cos * x - sin * z, y, sin * x + cos * z - 0.3), 1.0));
        }
        points
    }

    #[test]
    fn tilted_ground_plane_under_an_object_is_found() {
        let [x, y, z, height] = plane(&scene(0.2, true), 1.0).unwrap();
        let normal = DVec3::new(x, y, z);
        assert!(normal.angle_between(DVec3::new(-0.2f64.sin(), 0.0, 0.2f64.cos())) < 0.05, "{normal}");
        let standing = scene(0.2, true).iter().filter(|(p, _)| normal.dot(*p) > height).count();
        assert!((95..=105).contains(&standing), "{standing}");
    }

    #[test]
    fn walls_and_planes_without_an_object_are_not_ground() {
        assert_eq!(plane(&scene(1.2, true), 1.0), None);
        assert_eq!(plane(&scene(0.0, false), 1.0), None);
        assert_eq!(plane(&[], 1.0), None);
    }
}
