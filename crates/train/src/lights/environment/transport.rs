//! Irradiance of surfaces as a linear function of the light.

use rayon::prelude::*;

use crate::lights::LightSearch;
use relume_engine::evaluation;
use relume_scene::SplitLight;

/// Number of directions that are measured together, which bounds the memory.
const DIRECTIONS_AT_ONCE: usize = 32;
/// Number of rows that one task of the transposed product sums.
const ROWS_AT_ONCE: usize = 512;

/// Irradiance of points by each of the unknown lights at strength 1: radiance for a direction of the sky, irradiance for a dominant
/// light. `[point][light]`.
pub(super) struct Transport {
    rows: Vec<f32>,
    lights: usize,
}

impl Transport {
    /// Measures the transmittance from the Gaussians `points` towards `sky` and `lights`. Irradiance is a mean over neighbours, as the
    /// colours of the search are.
    pub(super) fn measure(
        search: &LightSearch<'_>,
        points: &[u32],
        sky: &[[f32; 3]],
        lights: &[SplitLight],
    ) -> Self {
        let solid_angle = 4.0 * std::f32::consts::PI / super::DIRECTIONS as f32;
        let sky_lights = sky.iter().map(|d| (SplitLight { direction: *d, radius: 0.0 }, solid_angle));
        let all: Vec<(SplitLight, f32)> =
            sky_lights.chain(lights.iter().map(|light| (*light, 1.0))).collect();
        let mut rows = vec![0.0; points.len() * all.len()];
        for (chunk, lights) in all.chunks(DIRECTIONS_AT_ONCE).enumerate() {
            let measured: Vec<SplitLight> = lights.iter().map(|(light, _)| *light).collect();
            let shares = evaluation::light_shares(search.state, &measured);
            let added = lights.par_iter().zip(&shares);
            let added: Vec<Vec<[f32; 1]>> =
                added.map(|((light, _), shares)| search.added_irradiance(*light, shares)).collect();
            for (row, point) in rows.chunks_mut(all.len()).zip(points) {
                let row = row[chunk * DIRECTIONS_AT_ONCE..].iter_mut();
                for ((value, of_light), (_, strength)) in row.zip(&added).zip(lights) {
                    *value = strength * of_light[*point as usize][0];
                }
            }
        }
        Self { rows, lights: all.len() }
    }

    /// Irradiance of each point under `light`.
    pub(super) fn irradiance(&self, light: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let of = |row: &[f32]| {
            let mut sum = [0.0; 3];
            for (t, light) in row.iter().zip(light) {
                (0..3).for_each(|c| sum[c] += t * light[c]);
            }
            sum
        };
        self.rows.par_chunks(self.lights).map(of).collect()
    }

    /// The transposed product: the sum of `values` over the points by the irradiance that each light gives them. The same for any number of threads.
    pub(super) fn transposed(&self, values: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let part = |(rows, values): (&[f32], &[[f32; 3]])| {
            let mut sums = vec![[0.0f32; 3]; self.lights];
            for (row, value) in rows.chunks(self.lights).zip(values) {
                for (sum, t) in sums.iter_mut().zip(row) {
                    (0..3).for_each(|c| sum[c] += t * value[c]);
                }
            }
            sums
        };
        let rows = self.rows.par_chunks(self.lights * ROWS_AT_ONCE);
        let parts: Vec<_> = rows.zip(values.par_chunks(ROWS_AT_ONCE)).map(part).collect();
        parts.into_iter().fold(vec![[0.0; 3]; self.lights], |mut sums, part| {
            for (sum, part) in sums.iter_mut().zip(part) {
                (0..3).for_each(|c| sum[c] += part[c]);
            }
            sums
        })
    }
}
