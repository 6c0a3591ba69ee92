//! Equirectangular HDR environment maps and the mapping between directions and texels.
//!
//! World +Z is up and row 0 looks along it; `u = 0.5 - atan2(d.y, d.x) / 2pi`, `v = acos(d.z) / pi`
//! (the convention of Blender and TensoIR).

use std::f64::consts::{PI, TAU};

use glam::DVec3;
use rayon::prelude::*;

use crate::ColumnShift;

/// Least number of rows that one thread resamples.
const ROWS_PER_TASK: usize = 16;

/// An equirectangular map of linear Rec.709 radiance, row-major, row 0 at world +Z.
#[derive(Debug, Clone, PartialEq)]
pub struct EnvMap {
    width: usize,
    height: usize,
    texels: Vec<[f32; 3]>,
}

/// Why an environment was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EnvMapError {
    /// The texel count does not fit the size, or the size is zero.
    #[error("environment: {width}x{height} does not fit {texels} texels")]
    Size {
        /// Width in texels.
        width: usize,
        /// Height in texels.
        height: usize,
        /// Texels given.
        texels: usize,
    },
    /// A texel is NaN or infinite.
    #[error("environment: texel at column {x}, row {y} is not finite")]
    NotFinite {
        /// Column.
        x: usize,
        /// Row.
        y: usize,
    },
    /// A texel is brighter than [`MAX_RADIANCE`].
    #[error("environment: texel at column {x}, row {y} is brighter than {MAX_RADIANCE:e}")]
    TooBright {
        /// Column.
        x: usize,
        /// Row.
        y: usize,
    },
}

/// Largest accepted radiance: sums over the whole sphere stay finite in f32, with up to 20 stops of exposure.
pub const MAX_RADIANCE: f32 = 1e30;

/// Corrections that [`EnvMap::new`] made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct EnvMapStats {
    /// Colour values below zero that were set to zero.
    pub clamped_negatives: usize,
}

impl EnvMap {
    /// A map of linear radiance; negative values are set to 0 and counted.
    ///
    /// # Errors
    /// [`EnvMapError::Size`] when the lengths disagree, [`EnvMapError::NotFinite`] for NaN or infinity,
    /// [`EnvMapError::TooBright`] beyond [`MAX_RADIANCE`].
    pub fn new(
        width: usize,
        height: usize,
        mut texels: Vec<[f32; 3]>,
    ) -> Result<(Self, EnvMapStats), EnvMapError> {
        if width == 0 || height == 0 || texels.len() != width * height {
            return Err(EnvMapError::Size { width, height, texels: texels.len() });
        }
        let mut stats = EnvMapStats::default();
        for (i, value) in texels.iter_mut().enumerate().flat_map(|(i, t)| t.iter_mut().map(move |v| (i, v))) {
            if !value.is_finite() {
                return Err(EnvMapError::NotFinite { x: i % width, y: i / width });
            }
            if *value > MAX_RADIANCE {
                return Err(EnvMapError::TooBright { x: i % width, y: i / width });
            }
            if *value < 0.0 {
                *value = 0.0;
                stats.clamped_negatives += 1;
            }
        }
        Ok((Self { width, height, texels }, stats))
    }

    /// A map of the same radiance everywhere.
    pub fn constant(width: usize, height: usize, radiance: [f32; 3]) -> Self {
        Self {
            width: width.max(1),
            height: height.max(1),
            texels: vec![radiance; width.max(1) * height.max(1)],
        }
    }

    /// A map with the value of `radiance` at each texel centre's direction.
    pub fn from_fn(width: usize, height: usize, mut radiance: impl FnMut(DVec3) -> [f32; 3]) -> Self {
        let texels = texel_directions(width, height).into_iter().map(|(d, _)| radiance(d)).collect();
        Self { width, height, texels }
    }

    /// Width in texels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height in texels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Row-major linear radiance.
    pub fn texels(&self) -> &[[f32; 3]] {
        &self.texels
    }

    /// Bilinear radiance along unit direction `d`; wraps in longitude, clamps at the poles.
    pub fn sample(&self, d: DVec3) -> [f32; 3] {
        let [u, v] = direction_to_uv(d);
        let x = u * self.width as f64 - 0.5;
        let y = (v * self.height as f64 - 0.5).clamp(0.0, (self.height - 1) as f64);
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = ((x - x0) as f32, (y - y0) as f32);
        let column = |i: f64| (i as i64).rem_euclid(self.width as i64) as usize;
        let row = |i: f64| (i as usize).min(self.height - 1);
        let texel = |xi: f64, yi: f64| self.texels[row(yi) * self.width + column(xi)];
        let (a, b) = (texel(x0, y0), texel(x0 + 1.0, y0));
        let (c, d) = (texel(x0, y0 + 1.0), texel(x0 + 1.0, y0 + 1.0));
        std::array::from_fn(|k| {
            (a[k] * (1.0 - fx) + b[k] * fx) * (1.0 - fy) + (c[k] * (1.0 - fx) + d[k] * fx) * fy
        })
    }

    /// The map, reduced to `rows` rows where it has more.
    #[must_use]
    pub fn at_most_rows(self, rows: usize) -> Self {
        match self.height > rows {
            true => self.resampled((self.width * rows / self.height).max(1), rows),
            false => self,
        }
    }

    /// The map at `width` x `height`: each new texel is the mean over the old texels that it covers, weighted by
    /// solid angle, so that total power does not change. A larger size repeats texels.
    #[must_use]
    pub fn resampled(&self, width: usize, height: usize) -> Self {
        let [columns, rows] = texel_overlaps((self.width, self.height), (width, height));
        let texel = |row: &[(usize, f64)], column: &[(usize, f64)]| {
            let mut sum = [0.0f64; 3];
            let mut weight = 0.0;
            for &(y, wy) in row {
                for &(x, wx) in column {
                    let t = self.texels[y * self.width + x];
                    (0..3).for_each(|k| sum[k] += f64::from(t[k]) * wx * wy);
                    weight += wx * wy;
                }
            }
            sum.map(|sum| (sum / weight) as f32)
        };
        let mut texels = vec![[0.0f32; 3]; width * height];
        let lines = texels.par_chunks_mut(width.max(1)).zip(&rows).with_min_len(ROWS_PER_TASK);
        lines.for_each(|(line, row)| {
            line.iter_mut().zip(&columns).for_each(|(to, column)| *to = texel(row, column));
        });
        Self { width, height, texels }
    }

    /// The map rotated about world +Z by `degrees` (counter-clockwise seen from above) and scaled.
    #[must_use]
    pub fn rotated_and_scaled(&self, degrees: f64, gain: f32) -> Self {
        let turn = ColumnShift::new(degrees.to_radians(), self.width);
        let mut texels = turn.apply(&self.texels).into_owned();
        texels.iter_mut().flatten().for_each(|v| *v *= gain);
        Self { width: self.width, height: self.height, texels }
    }
}

/// For each column and for each row of a map of size `to`, the columns or rows of a map of size `from` that it covers, with weights
/// whose products are proportional to the covered solid angle.
pub(crate) fn texel_overlaps(from: (usize, usize), to: (usize, usize)) -> [Vec<Vec<(usize, f64)>>; 2] {
    let columns = overlaps(from.0, to.0, |i, n| i as f64 / n as f64);
    // Rows are weighted by the sphere's area between their edges: cos is that area's antiderivative.
    let rows = overlaps(from.1, to.1, |i, n| 0.5 - 0.5 * (PI * i as f64 / n as f64).cos());
    [columns, rows]
}

/// For each of `to` cells, the `from` cells it overlaps with their overlaps; `edge(i, n)` maps cell edges to [0, 1].
fn overlaps(from: usize, to: usize, edge: impl Fn(usize, usize) -> f64) -> Vec<Vec<(usize, f64)>> {
    let overlap = |a: usize, b: usize| {
        let lo = edge(a, to).max(edge(b, from));
        let hi = edge(a + 1, to).min(edge(b + 1, from));
        hi - lo
    };
    (0..to)
        .map(|a| {
            // Both grids are uniform in index space, so only cells near the scaled index can overlap.
            let first = (a * from / to).saturating_sub(1);
            let last = ((a + 1) * from / to + 1).min(from);
            let cells = (first..last).map(|b| (b, overlap(a, b))).filter(|&(_, w)| w > 1e-15);
            cells.collect()
        })
        .collect()
}

/// Texture coordinates in [0, 1) x [0, 1] of a unit direction.
pub fn direction_to_uv(d: DVec3) -> [f64; 2] {
    let u = 0.5 - d.y.atan2(d.x) / TAU;
    [u.rem_euclid(1.0), d.z.clamp(-1.0, 1.0).acos() / PI]
}

/// The unit direction at texture coordinates (`u`, `v`), inverse of [`direction_to_uv`].
pub fn uv_to_direction(u: f64, v: f64) -> DVec3 {
    let phi = (0.5 - u) * TAU;
    let theta = v * PI;
    DVec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos())
}

/// Direction and solid angle (steradian, summing to 4 pi) of each texel centre, row-major.
pub fn texel_directions(width: usize, height: usize) -> Vec<(DVec3, f64)> {
    let column = |x: usize| ((0.5 - (x as f64 + 0.5) / width as f64) * TAU).sin_cos();
    let columns: Vec<(f64, f64)> = (0..width).map(column).collect();
    let mut out = Vec::with_capacity(width * height);
    for y in 0..height {
        let top = (PI * y as f64 / height as f64).cos();
        let bottom = (PI * (y + 1) as f64 / height as f64).cos();
        let solid_angle = (top - bottom) * TAU / width as f64;
        let (sin_theta, cos_theta) = ((y as f64 + 0.5) / height as f64 * PI).sin_cos();
        let around = columns.iter().map(|(sin, cos)| DVec3::new(sin_theta * cos, sin_theta * sin, cos_theta));
        out.extend(around.map(|d| (d, solid_angle)));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_round_trip_and_solid_angles_cover_the_sphere() {
        let dirs = texel_directions(16, 8);
        let total: f64 = dirs.iter().map(|&(_, w)| w).sum();
        assert!((total - 4.0 * PI).abs() < 1e-12);
        for (d, _) in dirs {
            let [u, v] = direction_to_uv(d);
            assert!((uv_to_direction(u, v) - d).length() < 1e-12);
        }
    }

    #[test]
    fn resampling_preserves_total_power() {
        let map = EnvMap::from_fn(64, 32, |d| [(d.x + 1.5) as f32, d.z.abs() as f32, 1.0]);
        let power = |m: &EnvMap| -> [f64; 3] {
            let mut sum = [0.0; 3];
            for (t, (_, w)) in m.texels().iter().zip(texel_directions(m.width(), m.height())) {
                (0..3).for_each(|k| sum[k] += f64::from(t[k]) * w);
            }
            sum
        };
        for size in [(16, 8), (20, 12)] {
            let small = map.resampled(size.0, size.1);
            for (a, b) in power(&map).into_iter().zip(power(&small)) {
                assert!((a - b).abs() < 1e-5 * a, "{a} {b}");
            }
        }
    }

    #[test]
    fn rotation_by_90_degrees_moves_light_from_x_to_y() {
        let map = EnvMap::from_fn(64, 32, |d| [(d.x as f32).max(0.0); 3]);
        let turned = map.rotated_and_scaled(90.0, 2.0);
        assert!((turned.sample(DVec3::Y)[0] - 2.0).abs() < 0.02);
        assert!(turned.sample(-DVec3::Y)[0] < 0.02);
    }

    #[test]
    fn nan_texels_are_refused_and_negative_ones_are_counted() {
        let nan = EnvMap::new(2, 1, vec![[0.0; 3], [f32::NAN; 3]]);
        assert_eq!(nan.unwrap_err(), EnvMapError::NotFinite { x: 1, y: 0 });
        let (map, stats) = EnvMap::new(1, 1, vec![[-1.0, 2.0, -0.5]]).unwrap();
        assert_eq!((map.texels()[0], stats.clamped_negatives), ([0.0, 2.0, 0.0], 2));
    }
}
