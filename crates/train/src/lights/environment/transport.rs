//! Irradiance of surfaces as a linear function of the light.

use rayon::prelude::*;

use crate::lights::LightSearch;
use relume_scene::SplitLight;

/// Number of directions that are measured together, which bounds the memory.
const DIRECTIONS_AT_ONCE: usize = 32;
/// Number of partial sums of a product, which the compiler computes in vector registers.
const PARTIAL_SUMS: usize = 8;
/// Number of rows that one task of the transposed product sums.
const ROWS_AT_ONCE: usize = 512;

/// Irradiance of points, the members of the search, by each of the unknown lights at strength 1: radiance for a direction of the sky,
/// irradiance for a dominant light. `[point][light]`.
pub(super) struct Transport {
    rows: Vec<f32>,
    lights: usize,
}

impl Transport {
    /// Measures the transmittance from the members of `search` towards `sky` and `lights`. Irradiance is a mean over neighbours, as the
    /// colours of the search are.
    pub(super) fn measure(search: &LightSearch<'_>, sky: &[[f32; 3]], lights: &[SplitLight]) -> Self {
        let solid_angle = 4.0 * std::f32::consts::PI / super::DIRECTIONS as f32;
        let sky_lights = sky.iter().map(|d| (SplitLight { direction: *d, radius: 0.0 }, solid_angle));
        let all: Vec<(SplitLight, f32)> =
            sky_lights.chain(lights.iter().map(|light| (*light, 1.0))).collect();
        let mut rows = vec![0.0; search.neighbours.members().len() * all.len()];
        for (chunk, lights) in all.chunks(DIRECTIONS_AT_ONCE).enumerate() {
            let measured: Vec<SplitLight> = lights.iter().map(|(light, _)| *light).collect();
            let shares = search.shares(&measured);
            let added = lights.par_iter().zip(&shares);
            let added: Vec<Vec<[f32; 1]>> =
                added.map(|((light, _), shares)| search.added_irradiance(*light, shares)).collect();
            for (point, row) in rows.chunks_mut(all.len()).enumerate() {
                let row = row[chunk * DIRECTIONS_AT_ONCE..].iter_mut();
                for ((value, of_light), (_, strength)) in row.zip(&added).zip(lights) {
                    *value = strength * of_light[point][0];
                }
            }
        }
        Self { rows, lights: all.len() }
    }

    /// Irradiance of each point under `light`.
    pub(super) fn irradiance(&self, light: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let channels = [0, 1, 2].map(|c| light.iter().map(|light| light[c]).collect::<Vec<f32>>());
        let of = |row: &[f32]| channels.each_ref().map(|channel| dot(row, channel));
        self.rows.par_chunks(self.lights).map(of).collect()
    }

    /// The transposed product: the sum of `values` over the points by the irradiance that each light gives them. The same for any number of threads.
    pub(super) fn transposed(&self, values: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let part = |(rows, values): (&[f32], &[[f32; 3]])| {
            let mut sums = [0, 1, 2].map(|_| vec![0.0f32; self.lights]);
            for (row, value) in rows.chunks(self.lights).zip(values) {
                for (sums, value) in sums.iter_mut().zip(value) {
                    sums.iter_mut().zip(row).for_each(|(sum, t)| *sum += t * value);
                }
            }
            sums
        };
        let rows = self.rows.par_chunks(self.lights * ROWS_AT_ONCE);
        let parts: Vec<_> = rows.zip(values.par_chunks(ROWS_AT_ONCE)).map(part).collect();
        parts.into_iter().fold(vec![[0.0; 3]; self.lights], |mut sums, part| {
            for (d, sum) in sums.iter_mut().enumerate() {
                (0..3).for_each(|c| sum[c] += part[c][d]);
            }
            sums
        })
    }
}

/// The sum of products, in eight partial sums.
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let (a, b) = (a.chunks_exact(PARTIAL_SUMS), b.chunks_exact(PARTIAL_SUMS));
    let rest: f32 = a.remainder().iter().zip(b.remainder()).map(|(a, b)| a * b).sum();
    let mut sums = [0.0f32; PARTIAL_SUMS];
    for (a, b) in a.zip(b) {
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            *sum += a * b;
        }
    }
    sums.iter().sum::<f32>() + rest
}
