//! Lobes of light: cells of nearly equal solid angle that together cover the sphere (docs/guide/light_matrix.md).

use std::f64::consts::PI;

use glam::DVec3;

use crate::light::map_rows::LOBE_ROWS;
use crate::{EnvMap, texel_directions};

/// Greatest number of lobes.
pub const MAX_LOBES: usize = 512;
/// Columns and rows of the map whose texels the lobes divide.
const SIZE: (usize, usize) = (2 * LOBE_ROWS, LOBE_ROWS);

/// `n` directions spread evenly over the sphere (Fibonacci spiral).
pub fn fibonacci_directions(n: usize) -> Vec<DVec3> {
    let golden = PI * (1.0 + 5.0f64.sqrt());
    (0..n)
        .map(|i| {
            let z = 1.0 - 2.0 * (i as f64 + 0.5) / n as f64;
            let r = (1.0 - z * z).max(0.0).sqrt();
            let phi = golden * (i as f64 + 0.5);
            DVec3::new(r * phi.cos(), r * phi.sin(), z)
        })
        .collect()
}

/// A partition of the sphere: each texel of a map of 256 x 128 texels belongs to the lobe whose direction is nearest to it.
/// The light of a lobe is 1 in its texels and 0 elsewhere, so the sum of all lobes is 1 everywhere.
#[derive(Debug, Clone, PartialEq)]
pub struct LightLobes {
    directions: Vec<DVec3>,
    solid_angles: Vec<f64>,
    lobe_of_texel: Vec<u16>,
}

impl LightLobes {
    /// `count` lobes, limited to 1 to [`MAX_LOBES`].
    pub fn new(count: usize) -> Self {
        let directions = fibonacci_directions(count.clamp(1, MAX_LOBES));
        let mut solid_angles = vec![0.0; directions.len()];
        let texels = texel_directions(SIZE.0, SIZE.1);
        let nearest = |d: DVec3| {
            let mut best = (0u16, f64::NEG_INFINITY);
            for (k, towards) in (0u16..).zip(&directions) {
                let cos = towards.dot(d);
                if cos > best.1 {
                    best = (k, cos);
                }
            }
            best.0
        };
        let lobe_of_texel: Vec<u16> = texels.iter().map(|(d, _)| nearest(*d)).collect();
        for (lobe, (_, solid_angle)) in lobe_of_texel.iter().zip(&texels) {
            solid_angles[usize::from(*lobe)] += solid_angle;
        }
        Self { directions, solid_angles, lobe_of_texel }
    }

    /// Unit direction of each lobe. Its number is the number of lobes.
    pub fn directions(&self) -> &[DVec3] {
        &self.directions
    }

    /// Solid angle of each lobe, steradian; together 4 pi.
    pub fn solid_angles(&self) -> &[f64] {
        &self.solid_angles
    }

    /// Columns and rows of the divided map.
    pub fn map_size(&self) -> (usize, usize) {
        SIZE
    }

    /// Lobe of each texel of the divided map, row-major.
    pub fn lobe_of_texel(&self) -> &[u16] {
        &self.lobe_of_texel
    }

    /// The lobe to which the texel at `direction` belongs.
    pub fn lobe_at(&self, direction: DVec3) -> usize {
        let [u, v] = crate::direction_to_uv(direction);
        let x = ((u * SIZE.0 as f64) as usize).min(SIZE.0 - 1);
        let y = ((v * SIZE.1 as f64) as usize).min(SIZE.1 - 1);
        usize::from(self.lobe_of_texel[y * SIZE.0 + x])
    }

    /// The sum of all lobes with these weights, linear radiance RGB. A missing weight is 0, and so is a negative one.
    pub fn combined(&self, weights: &[[f32; 3]]) -> EnvMap {
        let of = |lobe: &u16| weights.get(usize::from(*lobe)).map_or([0.0; 3], |w| w.map(|v| v.max(0.0)));
        let texels = self.lobe_of_texel.iter().map(of).collect();
        let map = EnvMap::new(SIZE.0, SIZE.1, texels);
        map.map_or_else(|_| EnvMap::constant(SIZE.0, SIZE.1, [0.0; 3]), |(map, _)| map)
    }

    /// The weights of `map`: its mean radiance over each lobe, weighted by solid angle. The combination with these weights has the
    /// power of the map and is, of all combinations, nearest to it.
    pub fn weights_of(&self, map: &EnvMap) -> Vec<[f64; 3]> {
        let map = map.resampled(SIZE.0, SIZE.1);
        let mut sums = vec![[0.0f64; 3]; self.directions.len()];
        let texels = map.texels().iter().zip(texel_directions(SIZE.0, SIZE.1)).zip(&self.lobe_of_texel);
        for ((radiance, (_, solid_angle)), lobe) in texels {
            let sum = &mut sums[usize::from(*lobe)];
            (0..3).for_each(|c| sum[c] += f64::from(radiance[c]) * solid_angle);
        }
        sums.iter_mut().zip(&self.solid_angles).for_each(|(sum, whole)| *sum = sum.map(|v| v / whole));
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_compare::worst;

    #[test]
    fn lobes_are_a_partition_of_unity() {
        for count in [1, 2, 32, 128, MAX_LOBES] {
            let lobes = LightLobes::new(count);
            assert_eq!(lobes.directions().len(), count);
            let mut sum = vec![0.0f32; 256 * 128];
            for k in 0..count {
                let mut one = vec![[0.0f32; 3]; count];
                one[k] = [1.0; 3];
                let map = lobes.combined(&one);
                sum.iter_mut().zip(map.texels()).for_each(|(s, t)| *s += t[1]);
                if count > 1 {
                    assert!(
                        map.texels().iter().any(|t| t[0] == 0.0),
                        "the control: one lobe is not the sphere"
                    );
                }
            }
            assert!(sum.iter().all(|s| *s == 1.0), "{count} lobes");
            let total: f64 = lobes.solid_angles().iter().sum();
            assert!((total - 4.0 * PI).abs() < 1e-9, "{total}");
        }
        assert_eq!(LightLobes::new(0).directions().len(), 1);
        assert_eq!(LightLobes::new(9999).directions().len(), MAX_LOBES);
    }

    #[test]
    fn lobes_have_nearly_equal_solid_angles() {
        for count in [32, 128, MAX_LOBES] {
            let lobes = LightLobes::new(count);
            let mean = 4.0 * PI / count as f64;
            let off = worst(lobes.solid_angles().iter().map(|w| (w / mean - 1.0).abs()));
            assert!(off < 0.3, "{count}: {off}");
        }
    }

    #[test]
    fn weights_of_a_combination_are_its_weights() {
        let lobes = LightLobes::new(48);
        let weights: Vec<[f32; 3]> =
            (0..48).map(|k| [1.0 + k as f32, 0.5 * k as f32, 48.0 - k as f32]).collect();
        let map = lobes.combined(&weights);
        let error = |found: &[[f64; 3]]| {
            let pairs = found.iter().flatten().zip(weights.iter().flatten());
            worst(pairs.map(|(a, b)| (a - f64::from(*b)).abs()))
        };
        assert!(error(&lobes.weights_of(&map)) < 1e-5);
        let turned = map.rotated_and_scaled(40.0, 1.0);
        assert!(error(&lobes.weights_of(&turned)) > 1.0, "the control: another map has other weights");
    }

    #[test]
    fn weights_keep_the_power_of_maps_of_every_size() {
        for (width, height) in [(64, 32), (300, 150), (1024, 512)] {
            let map = EnvMap::from_fn(width, height, |d| [1.0 + d.x as f32, (3.0 * d.z).exp() as f32, 0.2]);
            let lobes = LightLobes::new(37);
            let weights = lobes.weights_of(&map);
            for c in 0..3 {
                let pairs = weights.iter().zip(lobes.solid_angles());
                let found: f64 = pairs.map(|(w, solid_angle)| w[c] * solid_angle).sum();
                let texels = map.texels().iter().zip(texel_directions(width, height));
                let whole: f64 = texels.map(|(t, (_, w))| f64::from(t[c]) * w).sum();
                assert!((found / whole - 1.0).abs() < 1e-5, "{width} {c}: {found} of {whole}");
            }
        }
    }

    #[test]
    fn the_lobe_at_a_direction_is_that_of_its_texel() {
        let lobes = LightLobes::new(90);
        for ((d, _), lobe) in texel_directions(SIZE.0, SIZE.1).iter().zip(lobes.lobe_of_texel()) {
            assert_eq!(lobes.lobe_at(*d), usize::from(*lobe));
        }
        let found: Vec<usize> = lobes.directions().iter().map(|d| lobes.lobe_at(*d)).collect();
        assert_eq!(found, (0..90).collect::<Vec<_>>());
    }
}
