//! Environment operators as explicit linear maps (docs/MODEL.md section 4): tables = M L, and the gradient is M^T g.
//! Dominant lights may be split off first: the irradiance of each is one more linear function of the texels.

mod rows;

use std::sync::{Arc, OnceLock};

use glam::DVec3;
use rayon::prelude::*;

use crate::light::{CubeGrid, LightTables, SPECULAR_LEVELS, TableLight, brdf::ggx_d, padded, sh_eval};
use crate::{LightSplit, MAX_LIGHTS, SplitLight, sh_count, texel_directions};

use rows::{LANES, Slice, SlicedRows, add_rows};

/// Smallest number of rows, or of slices of rows, per task.
const NODES: usize = 32;
const SLICES: usize = 16;

/// Position of a roughness between two prefiltered levels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LevelPosition<T> {
    /// The level below.
    pub level: usize,
    /// Fraction of the way to the next level, 0 to 1.
    pub fraction: T,
    /// Derivative of the fraction by roughness; 0 where clamped.
    pub by_roughness: T,
}

impl<T: num_traits::Float> LevelPosition<T> {
    /// The position of `roughness`, clamped to the first and the last level.
    #[inline]
    pub fn of(roughness: T) -> Self {
        let at = |k: usize| T::from(SPECULAR_LEVELS[k]).unwrap_or_else(T::one);
        let last = SPECULAR_LEVELS.len() - 1;
        if !(roughness > at(0)) {
            return Self { level: 0, fraction: T::zero(), by_roughness: T::zero() };
        }
        if roughness >= at(last) {
            return Self { level: last - 1, fraction: T::one(), by_roughness: T::zero() };
        }
        let level = (0..last).rev().find(|&k| roughness >= at(k)).unwrap_or(0);
        let by_roughness = T::one() / (at(level + 1) - at(level));
        Self { level, fraction: (roughness - at(level)) * by_roughness, by_roughness }
    }
}

/// Resolution of the tables over directions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TableResolution {
    /// Nodes along a cube edge for normals.
    pub diffuse: usize,
    /// Nodes along a cube edge for the two sharpest levels.
    pub sharp: usize,
    /// Nodes along a cube edge for the other levels.
    pub rough: usize,
}

impl TableResolution {
    /// For optimisation: tables are rebuilt every step.
    pub const TRAINING: Self = Self { diffuse: 9, sharp: 17, rough: 9 };
}

/// One level's rows in compressed form: node k is `sum over entries[start[k]..start[k+1]] of weight * L[texel]`.
#[derive(Debug, Clone)]
struct SparseRows {
    start: Vec<u32>,
    entries: Vec<(u32, f32)>,
}

/// Sparse rows as two plain arrays, for devices: row k is `entries[start[k]..start[k + 1]]`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CompressedRows {
    /// First entry of each row, and the end.
    pub start: Vec<u32>,
    /// Column, and the bits of the weight.
    pub entries: Vec<[u32; 2]>,
}

impl CompressedRows {
    fn new(rows: impl Iterator<Item = Vec<(u32, f32)>>) -> Self {
        let mut out = Self { start: vec![0], entries: Vec::new() };
        for row in rows {
            out.entries.extend(row.iter().map(|(column, weight)| [*column, weight.to_bits()]));
            out.start.push(out.entries.len() as u32);
        }
        out
    }
}

/// The operators of one environment size, with the dominant lights that are split off first.
#[derive(Debug, Clone)]
pub struct EnvOperators {
    maps: Arc<OperatorMatrices>,
    split: LightSplit,
}

/// The linear maps of a whole environment.
#[derive(Debug)]
struct OperatorMatrices {
    width: usize,
    height: usize,
    sh_degree: usize,
    diffuse_grid: CubeGrid,
    specular_grids: [CubeGrid; SPECULAR_LEVELS.len()],
    /// `(n.w)+ dw`, node-major.
    cosine: SparseRows,
    cosine_transposed: SparseRows,
    specular: [SparseRows; SPECULAR_LEVELS.len()],
    specular_transposed: [SparseRows; SPECULAR_LEVELS.len()],
    /// A second copy of the prefilter levels, laid out for the CPU.
    slices: OnceLock<Slices>,
    /// `Y_j(w)` per texel, padded.
    harmonics: Vec<f32>,
    /// `dw` per texel, steradian.
    solid_angles: Vec<f32>,
}

#[derive(Debug)]
struct Slices {
    specular: [SlicedRows; SPECULAR_LEVELS.len()],
    transposed: [SlicedRows; SPECULAR_LEVELS.len()],
}

impl EnvOperators {
    /// Operators for `width` x `height` environments and visibility of degree `sh_degree`.
    pub fn new(width: usize, height: usize, sh_degree: usize, resolution: TableResolution) -> Self {
        let texels = texel_directions(width, height);
        let diffuse_grid = CubeGrid::new(resolution.diffuse);
        let cosine =
            SparseRows::new(&diffuse_grid, |n| texels.iter().map(|(d, w)| n.dot(*d).max(0.0) * w).collect());
        let specular_grids =
            std::array::from_fn(|k| CubeGrid::new(if k < 2 { resolution.sharp } else { resolution.rough }));
        // A lobe narrower than a texel could miss all texel centres, so it is widened to about one texel.
        let texel_angle = std::f64::consts::PI / height as f64;
        let specular: [SparseRows; SPECULAR_LEVELS.len()] = std::array::from_fn(|k| {
            let alpha = f64::from(SPECULAR_LEVELS[k]).powi(2).max(0.25 * texel_angle);
            SparseRows::new(&specular_grids[k], |r| lobe_weights(r, alpha, &texels))
        });
        let coefficients = padded(sh_count(sh_degree));
        let mut harmonics = vec![0.0f32; texels.len() * coefficients];
        for ((d, _), row) in texels.iter().zip(harmonics.chunks_mut(coefficients)) {
            sh_eval(sh_degree, d.to_array().map(|v| v as f32), row);
        }
        let maps = OperatorMatrices {
            width,
            height,
            sh_degree,
            diffuse_grid,
            cosine_transposed: cosine.transposed(texels.len()),
            cosine,
            specular_transposed: std::array::from_fn(|k| specular[k].transposed(texels.len())),
            slices: OnceLock::new(),
            specular_grids,
            specular,
            harmonics,
            solid_angles: texels.iter().map(|(_, w)| *w as f32).collect(),
        };
        Self { maps: Arc::new(maps), split: LightSplit::default() }
    }

    /// The same operators for environments split by `split`, which must fit their texels. An empty split gives operators of
    /// the whole environment.
    #[must_use]
    pub fn with_lights(&self, split: &LightSplit) -> Self {
        Self { maps: self.maps.clone(), split: split.clone() }
    }

    /// The split.
    pub fn split(&self) -> &LightSplit {
        &self.split
    }

    /// Columns and rows of the environments that the operators accept.
    pub fn size(&self) -> (usize, usize) {
        (self.maps.width, self.maps.height)
    }

    /// Sparse rows of the whole operator: first those of the normals' cosine, then those of each prefilter level, then
    /// [`MAX_LIGHTS`] rows of the lights' irradiance, empty beyond the last light.
    pub fn rows(&self) -> CompressedRows {
        let maps = &*self.maps;
        let levels = maps.specular.iter().flat_map(|rows| (0..rows.len()).map(|k| rows.row(k)));
        let whole = (0..maps.cosine.len()).map(|k| maps.cosine.row(k)).chain(levels);
        let rest = whole.map(|row| row.iter().map(|&(t, w)| (t, w * self.split.rest(t as usize))).collect());
        CompressedRows::new(rest.chain((0..MAX_LIGHTS).map(|k| self.light_row(k))))
    }

    /// `m_kt dw_t` of the texels in which light `k` has a share.
    fn light_row(&self, k: usize) -> Vec<(u32, f32)> {
        let shares = self.split.shares.iter().zip(&self.maps.solid_angles).enumerate();
        shares.filter(|(_, (m, _))| m[k] > 0.0).map(|(t, (m, w))| (t as u32, m[k] * w)).collect()
    }

    /// The transpose, two rows per texel: first its normals, then its nodes of all prefilter levels, numbered consecutively,
    /// followed by the lights.
    pub fn transposed_rows(&self) -> CompressedRows {
        let maps = &*self.maps;
        let mut first_node = [0u32; SPECULAR_LEVELS.len()];
        for k in 1..first_node.len() {
            first_node[k] = first_node[k - 1] + maps.specular[k - 1].len() as u32;
        }
        let first_light: u32 = maps.specular.iter().map(|rows| rows.len() as u32).sum();
        CompressedRows::new((0..2 * maps.width * maps.height).map(|row| {
            let (texel, rest) = (row / 2, self.split.rest(row / 2));
            if row % 2 == 0 {
                return maps.cosine_transposed.row(texel).iter().map(|&(n, w)| (n, w * rest)).collect();
            }
            let levels = maps.specular_transposed.iter().zip(first_node);
            let nodes =
                levels.flat_map(|(t, first)| t.row(texel).iter().map(move |&(n, w)| (first + n, w * rest)));
            let shares = self.split.shares.get(texel).into_iter().flatten().zip(first_light..);
            let lights = shares.filter(|(m, _)| **m > 0.0);
            nodes.chain(lights.map(|(m, node)| (node, m * maps.solid_angles[texel]))).collect()
        }))
    }

    /// `Y_j` of each texel, padded: `[texel][coefficient]`.
    pub fn harmonics(&self) -> &[f32] {
        &self.maps.harmonics
    }

    /// Zeroed tables of the shape that [`Self::apply`] returns.
    pub fn shape(&self) -> LightTables {
        let maps = &*self.maps;
        let coefficients = padded(sh_count(maps.sh_degree));
        let unlit = |light: &SplitLight| TableLight {
            direction: light.direction,
            radius: light.radius,
            irradiance: [0.0; 3],
        };
        LightTables {
            diffuse_grid: maps.diffuse_grid,
            coefficients,
            diffuse: vec![0.0; maps.diffuse_grid.len() * 3 * coefficients],
            specular_grids: maps.specular_grids,
            specular: maps.specular_grids.map(|grid| vec![[0.0; 3]; grid.len()]),
            lights: self.split.lights.iter().map(unlit).collect(),
        }
    }

    /// Degree of the visibility field that the diffuse table serves.
    pub fn sh_degree(&self) -> usize {
        self.maps.sh_degree
    }

    /// The tables of an environment given as `width * height` radiances: `M L` of the rest, and the lights.
    pub fn apply(&self, radiance: &[[f32; 3]]) -> LightTables {
        if self.split.is_empty() {
            return self.maps.apply(radiance);
        }
        let rest = |(t, l): (usize, &[f32; 3])| l.map(|v| v * self.split.rest(t));
        let mut tables = self.maps.apply(&radiance.iter().enumerate().map(rest).collect::<Vec<_>>());
        let light = |(k, light): (usize, &SplitLight)| {
            let mut irradiance = [0.0f32; 3];
            for (t, w) in self.light_row(k) {
                (0..3).for_each(|c| irradiance[c] += w * radiance[t as usize][c]);
            }
            TableLight { direction: light.direction, radius: light.radius, irradiance }
        };
        tables.lights = self.split.lights.iter().enumerate().map(light).collect();
        tables
    }

    /// The transpose of [`Self::apply`]: the gradient of each texel's radiance from the gradient of the tables.
    pub fn apply_transposed(&self, gradient: &LightTables) -> Vec<[f32; 3]> {
        let mut out = self.maps.apply_transposed(gradient);
        for (t, shares) in self.split.shares.iter().enumerate() {
            let rest = self.split.rest(t);
            out[t] = out[t].map(|g| g * rest);
            for (light, share) in gradient.lights.iter().zip(shares) {
                let weight = share * self.maps.solid_angles[t];
                (0..3).for_each(|c| out[t][c] += weight * light.irradiance[c]);
            }
        }
        out
    }
}

impl OperatorMatrices {
    fn slices(&self) -> &Slices {
        self.slices.get_or_init(|| Slices {
            specular: self.specular.each_ref().map(SparseRows::sliced),
            transposed: self.specular_transposed.each_ref().map(SparseRows::sliced),
        })
    }

    /// `M L`.
    fn apply(&self, radiance: &[[f32; 3]]) -> LightTables {
        let n = padded(sh_count(self.sh_degree));
        // F[t] = Y_j(t) L_c(t), the light that coefficient j passes at texel t.
        let products: Vec<f32> = radiance
            .par_iter()
            .zip(self.harmonics.par_chunks(n))
            .flat_map_iter(|(l, y)| (0..3).flat_map(move |c| y.iter().map(move |v| v * l[c])))
            .collect();
        let mut diffuse = vec![0.0f32; self.diffuse_grid.len() * 3 * n];
        diffuse.par_chunks_mut(3 * n).enumerate().with_min_len(NODES).for_each(|(node, out)| {
            add_rows(out, self.cosine.row(node), &products);
        });
        LightTables {
            diffuse_grid: self.diffuse_grid,
            coefficients: n,
            diffuse,
            specular_grids: self.specular_grids,
            specular: self.prefiltered(radiance),
            lights: Vec::new(),
        }
    }

    /// The prefiltered levels of an environment.
    fn prefiltered(&self, radiance: &[[f32; 3]]) -> [Vec<[f32; 3]>; SPECULAR_LEVELS.len()] {
        let by_level = &self.slices().specular;
        let levels = by_level.iter().enumerate();
        let slices: Vec<(usize, usize)> =
            levels.flat_map(|(level, rows)| (0..rows.len()).map(move |slice| (level, slice))).collect();
        let sums = slices.par_iter().with_min_len(SLICES).map(|(level, slice)| {
            let mut sums = Slice::default();
            by_level[*level].add(*slice, radiance, &mut sums);
            sums
        });
        let sums: Vec<Slice> = sums.collect();
        let mut rest = sums.iter();
        std::array::from_fn(|level| {
            let slices = rest.by_ref().take(by_level[level].len());
            let nodes = slices.flat_map(|[r, g, b]| (0..LANES).map(|lane| [r[lane], g[lane], b[lane]]));
            nodes.take(self.specular_grids[level].len()).collect()
        })
    }

    /// `M^T g`.
    fn apply_transposed(&self, gradient: &LightTables) -> Vec<[f32; 3]> {
        let n = padded(sh_count(self.sh_degree));
        let mut out = vec![[0.0f32; 3]; self.width * self.height];
        let transposed = &self.slices().transposed;
        let slices = out.par_chunks_mut(LANES).enumerate().with_min_len(2);
        slices.for_each_init(Vec::new, |products, (slice, texels)| {
            let mut by_specular = Slice::default();
            for (rows, by_level) in transposed.iter().zip(&gradient.specular) {
                rows.add(slice, by_level, &mut by_specular);
            }
            for (lane, out) in texels.iter_mut().enumerate() {
                let t = slice * LANES + lane;
                products.clear();
                products.resize(3 * n, 0.0f32);
                add_rows(products, self.cosine_transposed.row(t), &gradient.diffuse);
                let y = &self.harmonics[t * n..(t + 1) * n];
                *out = std::array::from_fn(|c| {
                    let diffuse: f32 = products[c * n..(c + 1) * n].iter().zip(y).map(|(a, b)| a * b).sum();
                    diffuse + by_specular[c][lane]
                });
            }
        });
        out
    }
}

/// Normalised prefilter weights around `r`: GGX over the half vector of R and w with N = V = R (Karis 2013).
fn lobe_weights(r: DVec3, alpha: f64, texels: &[(DVec3, f64)]) -> Vec<f64> {
    let weight = |(d, solid_angle): &(DVec3, f64)| {
        let cos = r.dot(*d);
        if cos <= 0.0 { 0.0 } else { ggx_d((0.5 + 0.5 * cos).sqrt(), alpha) * cos * solid_angle }
    };
    let mut weights: Vec<f64> = texels.iter().map(weight).collect();
    let total: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|w| *w /= total.max(1e-300));
    weights
}

impl SparseRows {
    /// Rows from a function that returns all weights of a node. Negligible entries are dropped and the rest is rescaled, so
    /// that the row keeps its sum.
    fn new(grid: &CubeGrid, weights: impl Fn(DVec3) -> Vec<f64> + Sync) -> Self {
        let rows: Vec<Vec<(u32, f32)>> = grid
            .directions()
            .into_par_iter()
            .map(|d| {
                let dense = weights(d);
                let total: f64 = dense.iter().sum();
                let floor = dense.iter().copied().fold(0.0, f64::max) * 1e-4;
                let kept: f64 = dense.iter().filter(|w| **w > floor).sum();
                let scale = if kept > 0.0 { total / kept } else { 0.0 };
                let keep = dense.iter().enumerate().filter(|(_, w)| **w > floor);
                keep.map(|(t, w)| (t as u32, (w * scale) as f32)).collect()
            })
            .collect();
        Self::from_rows(rows)
    }

    fn from_rows(rows: Vec<Vec<(u32, f32)>>) -> Self {
        let mut start = Vec::with_capacity(rows.len() + 1);
        start.push(0u32);
        let mut entries = Vec::with_capacity(rows.iter().map(Vec::len).sum());
        for row in rows {
            entries.extend(row);
            start.push(entries.len() as u32);
        }
        Self { start, entries }
    }

    fn len(&self) -> usize {
        self.start.len() - 1
    }

    fn row(&self, k: usize) -> &[(u32, f32)] {
        &self.entries[self.start[k] as usize..self.start[k + 1] as usize]
    }

    fn transposed(&self, columns: usize) -> Self {
        let mut rows = vec![Vec::new(); columns];
        for node in 0..self.start.len() - 1 {
            self.row(node).iter().for_each(|&(t, w)| rows[t as usize].push((node as u32, w)));
        }
        Self::from_rows(rows)
    }

    fn sliced(&self) -> SlicedRows {
        SlicedRows::new((0..self.len()).map(|k| self.row(k)))
    }
}

#[cfg(test)]
mod tests;
