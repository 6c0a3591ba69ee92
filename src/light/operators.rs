//! Environment operators as explicit linear maps (docs/MODEL.md section 4): tables = M L, and the gradient is M^T g.
//! Strong small lights may be taken out first: each is one more read-out of the texels.

use std::sync::Arc;

use glam::DVec3;
use rayon::prelude::*;

use crate::light::{CubeGrid, LightTables, SPECULAR_LEVELS, TableLight, brdf::ggx_d, padded, sh_eval};
use crate::scene::{LightSplit, MAX_LIGHTS, SplitLight, sh_count, texel_directions};

/// Where a roughness lies between two prefiltered levels.
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

/// How finely directions are tabulated.
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

/// The operators of one environment size, and what of an environment is taken out as lights first.
#[derive(Debug, Clone)]
pub struct EnvOperators {
    maps: Arc<Maps>,
    split: LightSplit,
}

/// The linear maps of a whole environment.
#[derive(Debug)]
struct Maps {
    width: usize,
    height: usize,
    order: usize,
    diffuse_grid: CubeGrid,
    specular_grids: [CubeGrid; SPECULAR_LEVELS.len()],
    /// `(n.w)+ dw`, node-major.
    cosine: SparseRows,
    cosine_transposed: SparseRows,
    specular: [SparseRows; SPECULAR_LEVELS.len()],
    specular_transposed: [SparseRows; SPECULAR_LEVELS.len()],
    /// `Y_j(w)` a texel, padded.
    harmonics: Vec<f32>,
    /// `dw` a texel.
    solid_angles: Vec<f32>,
}

impl EnvOperators {
    /// Operators for `width` x `height` environments and visibility of degree `order`.
    pub fn new(width: usize, height: usize, order: usize, resolution: TableResolution) -> Self {
        let texels = texel_directions(width, height);
        let diffuse_grid = CubeGrid::new(resolution.diffuse);
        let cosine =
            SparseRows::new(&diffuse_grid, |n| texels.iter().map(|(d, w)| n.dot(*d).max(0.0) * w).collect());
        let specular_grids =
            std::array::from_fn(|k| CubeGrid::new(if k < 2 { resolution.sharp } else { resolution.rough }));
        // A lobe narrower than a texel would fall between texel centres: widen it to about one texel.
        let texel_angle = std::f64::consts::PI / height as f64;
        let specular: [SparseRows; SPECULAR_LEVELS.len()] = std::array::from_fn(|k| {
            let alpha = f64::from(SPECULAR_LEVELS[k]).powi(2).max(0.25 * texel_angle);
            SparseRows::new(&specular_grids[k], |r| lobe_weights(r, alpha, &texels))
        });
        let coefficients = padded(sh_count(order));
        let mut harmonics = vec![0.0f32; texels.len() * coefficients];
        for ((d, _), row) in texels.iter().zip(harmonics.chunks_mut(coefficients)) {
            sh_eval(order, d.to_array().map(|v| v as f32), row);
        }
        let maps = Maps {
            width,
            height,
            order,
            diffuse_grid,
            cosine_transposed: cosine.transposed(texels.len()),
            specular_transposed: std::array::from_fn(|k| specular[k].transposed(texels.len())),
            cosine,
            specular_grids,
            specular,
            harmonics,
            solid_angles: texels.iter().map(|(_, w)| *w as f32).collect(),
        };
        Self { maps: Arc::new(maps), split: LightSplit::default() }
    }

    /// The same maps for environments of which `split` takes lights out; it must fit their texels. An empty one gives
    /// operators of the whole environment.
    #[must_use]
    pub fn with_lights(&self, split: &LightSplit) -> Self {
        Self { maps: self.maps.clone(), split: split.clone() }
    }

    /// What is taken out.
    pub fn split(&self) -> &LightSplit {
        &self.split
    }

    /// Columns and rows of the environments these operators take.
    pub fn size(&self) -> (usize, usize) {
        (self.maps.width, self.maps.height)
    }

    /// Sparse rows of the whole operator: those of the normals' cosine first, then the prefilter levels' one after another,
    /// then [`MAX_LIGHTS`] of the lights' irradiance, empty beyond the last light.
    pub fn rows(&self) -> CompressedRows {
        let maps = &*self.maps;
        let levels = maps.specular.iter().flat_map(|rows| (0..rows.len()).map(|k| rows.row(k)));
        let whole = (0..maps.cosine.len()).map(|k| maps.cosine.row(k)).chain(levels);
        let rest = whole.map(|row| row.iter().map(|&(t, w)| (t, w * self.split.rest(t as usize))).collect());
        CompressedRows::new(rest.chain((0..MAX_LIGHTS).map(|k| self.light_row(k))))
    }

    /// `m_kt dw_t` of the texels that light `k` has a share in.
    fn light_row(&self, k: usize) -> Vec<(u32, f32)> {
        let shares = self.split.shares.iter().zip(&self.maps.solid_angles).enumerate();
        shares.filter(|(_, (m, _))| m[k] > 0.0).map(|(t, (m, w))| (t as u32, m[k] * w)).collect()
    }

    /// The transpose, two rows a texel: its normals, then its nodes of all prefilter levels counted through and the lights
    /// behind them.
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

    /// Empty tables of the shape [`Self::apply`] gives.
    pub fn shape(&self) -> LightTables {
        self.apply(&vec![[0.0; 3]; self.maps.width * self.maps.height])
    }

    /// Degree of the visibility field the diffuse table serves.
    pub fn order(&self) -> usize {
        self.maps.order
    }

    /// The tables of an environment given as `width * height` radiances: `M L` of what is not a light's, and the lights.
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

impl Maps {
    /// `M L`.
    fn apply(&self, radiance: &[[f32; 3]]) -> LightTables {
        let n = padded(sh_count(self.order));
        // F[t] = Y_j(t) L_c(t), the light that a coefficient lets through at texel t.
        let products: Vec<f32> = radiance
            .par_iter()
            .zip(self.harmonics.par_chunks(n))
            .flat_map_iter(|(l, y)| (0..3).flat_map(move |c| y.iter().map(move |v| v * l[c])))
            .collect();
        let mut diffuse = vec![0.0f32; self.diffuse_grid.len() * 3 * n];
        diffuse.par_chunks_mut(3 * n).enumerate().for_each(|(node, out)| {
            for &(t, w) in self.cosine.row(node) {
                let t = t as usize * 3 * n;
                out.iter_mut().zip(&products[t..t + 3 * n]).for_each(|(o, v)| *o += w * v);
            }
        });
        LightTables {
            diffuse_grid: self.diffuse_grid,
            coefficients: n,
            diffuse,
            specular_grids: self.specular_grids,
            specular: std::array::from_fn(|k| self.specular[k].times(radiance)),
            lights: Vec::new(),
        }
    }

    /// `M^T g`.
    fn apply_transposed(&self, gradient: &LightTables) -> Vec<[f32; 3]> {
        let n = padded(sh_count(self.order));
        (0..self.width * self.height)
            .into_par_iter()
            .map(|t| {
                let mut products = vec![0.0f32; 3 * n];
                for &(node, w) in self.cosine_transposed.row(t) {
                    let row = &gradient.diffuse[node as usize * 3 * n..(node as usize + 1) * 3 * n];
                    products.iter_mut().zip(row).for_each(|(o, v)| *o += w * v);
                }
                let y = &self.harmonics[t * n..(t + 1) * n];
                let mut out: [f32; 3] = std::array::from_fn(|c| {
                    products[c * n..(c + 1) * n].iter().zip(y).map(|(a, b)| a * b).sum()
                });
                for (rows, grad) in self.specular_transposed.iter().zip(&gradient.specular) {
                    for &(node, w) in rows.row(t) {
                        (0..3).for_each(|c| out[c] += w * grad[node as usize][c]);
                    }
                }
                out
            })
            .collect()
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
    /// Rows from a function giving all weights of a node; entries too small to matter are dropped and the
    /// rest rescaled, so a row's sum is kept.
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

    fn times(&self, radiance: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let node = |k: usize| {
            let mut sum = [0.0f32; 3];
            for &(t, w) in self.row(k) {
                (0..3).for_each(|c| sum[c] += w * radiance[t as usize][c]);
            }
            sum
        };
        (0..self.start.len() - 1).into_par_iter().map(node).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn irradiance(tables: &LightTables, visibility: &[f32], n: DVec3) -> [f32; 3] {
        let taps = tables.diffuse_grid.lookup(n.to_array().map(|v| v as f32));
        std::array::from_fn(|c| {
            let dot = |k: usize| -> f32 {
                let row = tables.diffuse_rows(taps.node[k])[c];
                row.iter().zip(visibility).map(|(a, b)| a * b).sum()
            };
            (0..4).map(|k| taps.weight[k] * dot(k)).sum()
        })
    }

    fn open_sky() -> Vec<f32> {
        let mut c = vec![0.0; 32];
        c[0] = 2.0 * std::f32::consts::PI.sqrt();
        c
    }

    #[test]
    fn one_bright_texel_lights_the_sphere_from_its_own_side() {
        let operators = EnvOperators::new(32, 16, 4, TableResolution::TRAINING);
        for (index, (d, solid_angle)) in texel_directions(32, 16).into_iter().enumerate().step_by(37) {
            let mut radiance = vec![[0.0; 3]; 512];
            radiance[index] = [1.0, 2.0, 0.0];
            let tables = operators.apply(&radiance);
            let [r, g, b] = irradiance(&tables, &open_sky(), d);
            let expected = solid_angle as f32;
            assert!(
                (r / expected - 1.0).abs() < 0.02 && (g / r - 2.0).abs() < 1e-4 && b == 0.0,
                "{r} {expected}"
            );
            assert!(irradiance(&tables, &open_sky(), -d)[0].abs() < 1e-6, "the far side must stay dark");
            let level = &tables.specular[1];
            let brightest = (0..level.len()).max_by(|a, b| level[*a][0].total_cmp(&level[*b][0])).unwrap();
            assert!(tables.specular_grids[1].directions()[brightest].dot(d) > 0.97);
        }
    }

    #[test]
    fn a_constant_sky_gives_pi_and_one() {
        let tables = EnvOperators::new(32, 16, 4, TableResolution::TRAINING).apply(&[[1.0; 3]; 512]);
        for n in CubeGrid::new(5).directions() {
            let e = irradiance(&tables, &open_sky(), n)[0];
            assert!((e / std::f32::consts::PI - 1.0).abs() < 0.01, "{n} {e}");
        }
        assert!(tables.specular.iter().flatten().all(|v| (v[0] - 1.0).abs() < 1e-4));
    }

    #[test]
    fn the_transposed_operator_is_the_transpose() {
        let operators = EnvOperators::new(16, 8, 2, TableResolution::TRAINING);
        let radiance: Vec<[f32; 3]> = (0..128).map(|i| [(i % 7) as f32, (i % 5) as f32, 1.0]).collect();
        let tables = operators.apply(&radiance);
        let mut probe = tables.zeroed();
        probe.diffuse.iter_mut().enumerate().for_each(|(i, v)| *v = ((i * 31) % 11) as f32 - 5.0);
        for level in &mut probe.specular {
            level.iter_mut().enumerate().for_each(|(i, v)| *v = [(i % 3) as f32, 1.0, -((i % 4) as f32)]);
        }
        let dot3 =
            |a: &[f32; 3], b: &[f32; 3]| (0..3).map(|c| f64::from(a[c]) * f64::from(b[c])).sum::<f64>();
        let flat = |t: &LightTables, u: &LightTables| {
            let d: f64 = t.diffuse.iter().zip(&u.diffuse).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
            let pairs = t.specular.iter().flatten().zip(u.specular.iter().flatten());
            d + pairs.map(|(a, b)| dot3(a, b)).sum::<f64>()
        };
        let forward = flat(&tables, &probe);
        let back = operators.apply_transposed(&probe);
        let backward: f64 = back.iter().zip(&radiance).map(|(a, b)| dot3(a, b)).sum();
        assert!((forward - backward).abs() < 1e-4 * forward.abs().max(1.0), "{forward} {backward}");
    }

    #[test]
    fn rest_and_lights_are_the_whole_and_the_transposed_is_the_transpose_with_lights() {
        let whole = EnvOperators::new(16, 8, 1, TableResolution::TRAINING);
        let radiance: Vec<[f32; 3]> = (0..128).map(|i| [(i % 7) as f32, (i % 5) as f32, 1.0]).collect();
        let mut shares = vec![[0.0; MAX_LIGHTS]; 128];
        (20..29).for_each(|t| shares[t] = [0.5, 0.125, 0.25, 0.0]);
        shares[90] = [0.0, 1.0, 0.0, 0.0];
        let light = SplitLight { direction: [0.0, 0.6, 0.8], radius: 0.02 };
        let split = LightSplit { lights: vec![light; 3], shares: shares.clone() };
        let operators = whole.with_lights(&split);
        let tables = operators.apply(&radiance);
        // A constant weight of the tables reads the whole power: nothing is lost, and nothing counted twice.
        let taken = whole.apply(
            &radiance
                .iter()
                .zip(&shares)
                .map(|(l, m)| l.map(|v| v * m.iter().sum::<f32>()))
                .collect::<Vec<_>>(),
        );
        let all = whole.apply(&radiance);
        for (i, v) in all.diffuse.iter().enumerate() {
            assert!((tables.diffuse[i] + taken.diffuse[i] - v).abs() < 1e-4);
        }
        for c in 0..3 {
            let angles = texel_directions(16, 8);
            let power = |share: &dyn Fn(usize) -> f64| -> f64 {
                (0..128).map(|t| share(t) * angles[t].1 * f64::from(radiance[t][c])).sum()
            };
            for k in 0..3 {
                let expected = power(&|t| f64::from(shares[t][k]));
                assert!((f64::from(tables.lights[k].irradiance[c]) - expected).abs() < 1e-5);
            }
        }
        assert!(all.diffuse.iter().zip(&tables.diffuse).any(|(a, b)| (a - b).abs() > 0.01), "the control");
        let mut probe = tables.zeroed();
        probe.diffuse.iter_mut().enumerate().for_each(|(i, v)| *v = ((i * 31) % 11) as f32 - 5.0);
        probe.lights.iter_mut().enumerate().for_each(|(i, l)| l.irradiance = [i as f32 + 3.0, -1.0, 2.0]);
        let pairs = tables.lights.iter().zip(&probe.lights);
        let lights: f64 = pairs
            .flat_map(|(a, b)| (0..3).map(|c| f64::from(a.irradiance[c]) * f64::from(b.irradiance[c])))
            .sum();
        let rows = tables.diffuse.iter().zip(&probe.diffuse).map(|(a, b)| f64::from(*a) * f64::from(*b));
        let forward = rows.sum::<f64>() + lights;
        let backward = operators.apply_transposed(&probe);
        let backward: f64 = backward
            .iter()
            .zip(&radiance)
            .flat_map(|(a, b)| (0..3).map(|c| f64::from(a[c]) * f64::from(b[c])))
            .sum();
        assert!((forward - backward).abs() < 1e-4 * forward.abs().max(1.0), "{forward} {backward}");
        assert!((forward - lights - backward).abs() > 1e-3 * forward.abs(), "the control: lights count");
    }

    #[test]
    fn compressed_rows_are_the_operators_with_lights() {
        let mut shares = vec![[0.0; MAX_LIGHTS]; 32];
        shares[9] = [0.5, 0.25, 0.0, 0.0];
        let light = SplitLight { direction: [1.0, 0.0, 0.0], radius: 0.0 };
        let resolution = TableResolution { diffuse: 3, sharp: 3, rough: 3 };
        let operators = EnvOperators::new(8, 4, 0, resolution)
            .with_lights(&LightSplit { lights: vec![light; 2], shares });
        let (rows, back) = (operators.rows(), operators.transposed_rows());
        let radiance: Vec<[f32; 3]> = (0..32).map(|i| [1.0 + i as f32; 3]).collect();
        let tables = operators.apply(&radiance);
        let row = |k: usize| &rows.entries[rows.start[k] as usize..rows.start[k + 1] as usize];
        let value = |k: usize| -> f32 {
            row(k).iter().map(|[t, w]| f32::from_bits(*w) * radiance[*t as usize][0]).sum()
        };
        let nodes: usize = tables.diffuse_grid.len() + tables.specular.iter().map(Vec::len).sum::<usize>();
        assert_eq!(rows.start.len(), nodes + MAX_LIGHTS + 1);
        for k in 0..2 {
            assert!((value(nodes + k) - tables.lights[k].irradiance[0]).abs() < 1e-5);
        }
        assert!(value(nodes) > 1.0 && value(nodes + 2) == 0.0);
        assert!((value(tables.diffuse_grid.len()) - tables.specular[0][0][0]).abs() < 1e-3);
        let texel = &back.entries[back.start[19] as usize..back.start[20] as usize];
        let specular = (nodes - tables.diffuse_grid.len()) as u32;
        assert_eq!(texel.iter().filter(|[node, _]| *node >= specular).count(), 2);
    }
}
