//! The weights of a light for the parts of a light matrix (docs/guide/light_matrix.md).

use glam::DVec3;

use crate::light::{LightLobes, TableLight, dominant_lights};
use crate::{Illumination, SplitLight};

/// Largest angle between a dominant light and the small light of a matrix that takes its weight, degrees.
pub const SUN_TOLERANCE_DEG: f64 = 1.0;

/// Weights of a light, RGB, linear Rec.709.
#[derive(Debug, Clone, PartialEq)]
pub struct MatrixWeights {
    /// Mean radiance over each lobe.
    pub lobes: Vec<[f64; 3]>,
    /// Irradiance of each small light.
    pub suns: Vec<[f64; 3]>,
    /// Dominant lights for which the matrix has no small light: unit direction and the lobe that contains them.
    pub in_lobes: Vec<(DVec3, usize)>,
}

impl MatrixWeights {
    /// The weights of `light` for a matrix of `lobes` and the small lights `suns`. A matrix without small lights takes the whole light
    /// in its lobes. Lobes and small lights together have the power of the light.
    pub fn of(light: &Illumination, lobes: &LightLobes, suns: &[SplitLight]) -> Self {
        let (mut of_suns, mut in_lobes) = (vec![[0.0; 3]; suns.len()], Vec::new());
        if suns.is_empty() {
            return Self { lobes: lobes.weights_of(&light.environment), suns: of_suns, in_lobes };
        }
        let (rest, lights) = dominant_lights(light);
        let mut of_lobes = lobes.weights_of(&rest);
        for light in &lights {
            let irradiance = light.irradiance.map(f64::from);
            match nearest(light, suns) {
                Some(k) => (0..3).for_each(|c| of_suns[k][c] += irradiance[c]),
                None => {
                    let direction = vector(light.direction);
                    let k = lobes.lobe_at(direction);
                    let solid_angle = lobes.solid_angles()[k];
                    (0..3).for_each(|c| of_lobes[k][c] += irradiance[c] / solid_angle);
                    in_lobes.push((direction, k));
                }
            }
        }
        Self { lobes: of_lobes, suns: of_suns, in_lobes }
    }

    /// Weights of all columns of a matrix, lobes first.
    pub fn columns(&self) -> Vec<[f32; 3]> {
        self.lobes.iter().chain(&self.suns).map(|w| w.map(|v| v as f32)).collect()
    }
}

/// The small light in the direction of `light`.
fn nearest(light: &TableLight, suns: &[SplitLight]) -> Option<usize> {
    let cosines = suns.iter().map(|sun| vector(sun.direction).dot(vector(light.direction)));
    let (k, cos) = cosines.enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
    (cos >= SUN_TOLERANCE_DEG.to_radians().cos()).then_some(k)
}

fn vector(v: [f32; 3]) -> DVec3 {
    DVec3::from_array(v.map(f64::from)).normalize_or(DVec3::Z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{EnvMap, texel_directions};

    fn sky() -> Illumination {
        let sun = DVec3::new(0.6, 0.0, 0.8);
        EnvMap::from_fn(128, 64, |d| {
            [1.0 + 0.5 * d.z as f32, 0.7, if d.dot(sun) > 0.999 { 4000.0 } else { 0.3 }]
        })
        .into()
    }

    fn suns(light: &Illumination) -> Vec<SplitLight> {
        dominant_lights(light).1.iter().map(SplitLight::from).collect()
    }

    fn power(light: &Illumination) -> [f64; 3] {
        let map = &light.environment;
        let mut sum = [0.0; 3];
        for (t, (_, w)) in map.texels().iter().zip(texel_directions(map.width(), map.height())) {
            (0..3).for_each(|c| sum[c] += f64::from(t[c]) * w);
        }
        sum
    }

    fn power_of(weights: &MatrixWeights, lobes: &LightLobes) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for (w, solid_angle) in weights.lobes.iter().zip(lobes.solid_angles()) {
            (0..3).for_each(|c| sum[c] += w[c] * solid_angle);
        }
        weights.suns.iter().for_each(|w| (0..3).for_each(|c| sum[c] += w[c]));
        sum
    }

    #[test]
    fn the_sun_of_a_map_has_its_own_weight_only_at_its_place() {
        let (light, lobes) = (sky(), LightLobes::new(60));
        let suns = suns(&light);
        assert_eq!(suns.len(), 1);
        let own = MatrixWeights::of(&light, &lobes, &suns);
        assert!(own.suns[0][2] > 5.0 && own.in_lobes.is_empty(), "{own:?}");
        assert!(own.lobes.iter().all(|w| w[2] < 1.0), "no lobe contains the sun");
        let turned = light.rotated_and_scaled(40.0, 1.0);
        let elsewhere = MatrixWeights::of(&turned, &lobes, &suns);
        assert_eq!(elsewhere.suns, [[0.0; 3]]);
        let (direction, k) = elsewhere.in_lobes[0];
        assert!(elsewhere.lobes[k][2] > 10.0, "{}", elsewhere.lobes[k][2]);
        assert!((direction.y.atan2(direction.x).to_degrees() - 40.0).abs() < 2.0, "{direction}");
        let without = MatrixWeights::of(&light, &lobes, &[]);
        assert!(without.suns.is_empty() && without.in_lobes.is_empty());
        for weights in [&own, &elsewhere, &without] {
            let (found, whole) = (power_of(weights, &lobes), power(&light));
            for c in 0..3 {
                assert!((found[c] / whole[c] - 1.0).abs() < 1e-4, "{found:?} of {whole:?}");
            }
        }
        assert_eq!(own.columns().len(), 61);
    }
}
