//! Light tables of all lobes at once. They hold the same values as [`rendering_tables`](crate::light::rendering_tables) of each
//! lobe's map, up to rounding, and take about the time of one map: every texel belongs to one lobe, so each sample of a map is a
//! sample of one lobe or a few.

use std::ops::Range;

use rayon::prelude::*;

use crate::environment::texel_overlaps;
use crate::light::map_rows::DIFFUSE_ROWS;
use crate::light::prefilter::{Cell, DIFFUSE_NODES, SPECULAR_NODES, has_coarser_level};
use crate::light::reflection_lobe::{Places, ReflectionLobe};
use crate::light::{CubeGrid, LightLobes, SPECULAR_LEVELS, sh_eval};
use crate::{sh_count, texel_directions};

/// Light tables of lobes of radiance 1, one number per lobe.
#[derive(Debug, Clone, PartialEq)]
pub struct LobeTables {
    /// Grid of normals.
    pub diffuse_grid: CubeGrid,
    /// Grid of reflection directions, per level.
    pub specular_grids: [CubeGrid; SPECULAR_LEVELS.len()],
    lobes: usize,
    coefficients: usize,
    /// `[node][coefficient][lobe]`.
    diffuse: Vec<f32>,
    /// `[node][lobe]` per level.
    specular: [Vec<f32>; SPECULAR_LEVELS.len()],
}

impl LobeTables {
    /// The tables of `lobes` for visibility fields of degree `sh_degree`.
    pub fn new(lobes: &LightLobes, sh_degree: usize) -> Self {
        let pyramid = pyramid(LobeMap::of(lobes));
        let sizes: Vec<(usize, usize)> = pyramid.iter().map(|map| map.size).collect();
        let count = lobes.directions().len();
        let specular_grids = SPECULAR_NODES.map(CubeGrid::new);
        let specular = std::array::from_fn(|k| {
            let lobe = ReflectionLobe::new(k, &sizes);
            let nodes = specular_grids[k].directions();
            let mut out = vec![0.0f32; nodes.len() * count];
            out.par_chunks_mut(count).zip(&nodes).for_each_init(Places::default, |places, (row, r)| {
                lobe.places_around(*r, places);
                add_filtered(&pyramid, &lobe, places, row);
            });
            out
        });
        let diffuse_grid = CubeGrid::new(DIFFUSE_NODES);
        let diffuse = diffuse_transfer(&diffuse_grid, LobeMap::of(lobes), sh_degree, count);
        let coefficients = sh_count(sh_degree);
        Self { diffuse_grid, specular_grids, lobes: count, coefficients, diffuse, specular }
    }

    /// Number of lobes.
    pub fn lobes(&self) -> usize {
        self.lobes
    }

    /// Number of visibility coefficients.
    pub fn coefficients(&self) -> usize {
        self.coefficients
    }

    /// Irradiance at normal `node` through visibility `Y_j` alone, `j` = `coefficient`, of the lobes in `range`.
    #[inline]
    pub fn diffuse(&self, node: usize, coefficient: usize, range: &Range<usize>) -> &[f32] {
        let first = (node * self.coefficients + coefficient) * self.lobes;
        &self.diffuse[first + range.start..first + range.end]
    }

    /// Prefiltered radiance at `node` of a level of [`SPECULAR_LEVELS`], of the lobes in `range`.
    #[inline]
    pub fn specular(&self, level: usize, node: usize, range: &Range<usize>) -> &[f32] {
        &self.specular[level][node * self.lobes + range.start..node * self.lobes + range.end]
    }
}

/// A map of lobes: for each texel the share of each lobe that has one.
struct LobeMap {
    size: (usize, usize),
    /// First entry of each texel, and the end.
    first: Vec<u32>,
    /// Lobe and share.
    entries: Vec<(u16, f32)>,
}

impl LobeMap {
    fn of(lobes: &LightLobes) -> Self {
        let entries: Vec<(u16, f32)> = lobes.lobe_of_texel().iter().map(|lobe| (*lobe, 1.0)).collect();
        Self { size: lobes.map_size(), first: (0..=entries.len() as u32).collect(), entries }
    }

    #[inline(always)]
    fn texel(&self, t: usize) -> &[(u16, f32)] {
        &self.entries[self.first[t] as usize..self.first[t + 1] as usize]
    }

    /// As [`EnvMap::resampled`](crate::EnvMap::resampled) of each lobe.
    fn resampled(&self, size: (usize, usize)) -> Self {
        let [columns, rows] = texel_overlaps(self.size, size);
        let (mut first, mut entries) = (vec![0u32], Vec::new());
        let mut sums: Vec<(u16, f64)> = Vec::new();
        for row in &rows {
            for column in &columns {
                sums.clear();
                let mut total = 0.0;
                for &(y, wy) in row {
                    for &(x, wx) in column {
                        total += wx * wy;
                        for &(lobe, share) in self.texel(y * self.size.0 + x) {
                            add(&mut sums, lobe, f64::from(share) * wx * wy);
                        }
                    }
                }
                entries.extend(sums.iter().map(|&(lobe, sum)| (lobe, (sum / total) as f32)));
                first.push(entries.len() as u32);
            }
        }
        Self { size, first, entries }
    }
}

fn add(sums: &mut Vec<(u16, f64)>, lobe: u16, value: f64) {
    match sums.iter_mut().find(|(other, _)| *other == lobe) {
        Some((_, sum)) => *sum += value,
        None => sums.push((lobe, value)),
    }
}

/// `map` and its reductions by two.
fn pyramid(map: LobeMap) -> Vec<LobeMap> {
    let mut levels = vec![map];
    while let Some(last) = levels.last() {
        if !has_coarser_level(last.size.1) {
            break;
        }
        let next = last.resampled(((last.size.0 / 2).max(1), (last.size.1 / 2).max(1)));
        levels.push(next);
    }
    levels
}

/// Adds to `out` the mean radiance of each lobe of light over a lobe of reflection at `places`.
fn add_filtered(pyramid: &[LobeMap], lobe: &ReflectionLobe, places: &Places, out: &mut [f32]) {
    for (tap, (u, v)) in lobe.taps.iter().zip(places.u.iter().zip(&places.v)) {
        let uv = [*u, *v];
        let coarse = (tap.low + 1).min(pyramid.len() - 1);
        for (level, share) in [(tap.low, 1.0 - tap.fraction), (coarse, tap.fraction)] {
            if share > 0.0 {
                add_bilinear(&pyramid[level], uv, tap.weight * share, out);
            }
        }
    }
}

/// Adds `weight` times the lobes at `uv`, interpolated between texels.
#[inline(always)]
fn add_bilinear(map: &LobeMap, uv: [f32; 2], weight: f32, out: &mut [f32]) {
    let Cell { texels, across, down } = Cell::around(map.size, uv);
    let (upper, lower) = (weight * (1.0 - down), weight * down);
    let weights = [upper * (1.0 - across), upper * across, lower * (1.0 - across), lower * across];
    for (t, weight) in texels.into_iter().zip(weights) {
        for &(lobe, share) in map.texel(t) {
            out[usize::from(lobe)] += weight * share;
        }
    }
}

/// `T_j(n) = int Y_j L (n . w)+ dw` at each node for each lobe, as `[node][coefficient][lobe]`.
fn diffuse_transfer(grid: &CubeGrid, map: LobeMap, sh_degree: usize, count: usize) -> Vec<f32> {
    let map = if map.size.1 > DIFFUSE_ROWS { map.resampled((2 * DIFFUSE_ROWS, DIFFUSE_ROWS)) } else { map };
    let n = sh_count(sh_degree);
    let directions = texel_directions(map.size.0, map.size.1);
    let mut products = vec![0.0f32; directions.len() * n];
    for ((d, w), row) in directions.iter().zip(products.chunks_exact_mut(n)) {
        sh_eval(sh_degree, d.to_array().map(|v| v as f32), row);
        row.iter_mut().for_each(|y| *y *= *w as f32);
    }
    let nodes = grid.directions();
    let mut out = vec![0.0f32; nodes.len() * n * count];
    out.par_chunks_mut(n * count).zip(&nodes).for_each_init(
        || vec![0.0f32; n * count],
        |by_lobe, (row, node)| {
            by_lobe.fill(0.0);
            for (t, ((d, _), product)) in directions.iter().zip(products.chunks_exact(n)).enumerate() {
                let cos = node.dot(*d) as f32;
                if cos <= 0.0 {
                    continue;
                }
                for &(lobe, share) in map.texel(t) {
                    let sums = &mut by_lobe[usize::from(lobe) * n..(usize::from(lobe) + 1) * n];
                    sums.iter_mut().zip(product).for_each(|(sum, p)| *sum += cos * share * p);
                }
            }
            for (lobe, sums) in by_lobe.chunks_exact(n).enumerate() {
                sums.iter().enumerate().for_each(|(j, sum)| row[j * count + lobe] = *sum);
            }
        },
    );
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::rendering_tables;
    use relume_compare::largest_difference;

    /// Largest difference between the tables of `weighted` as a map, and the weighted sum of the tables of its lobes.
    fn difference(lobes: &LightLobes, weights: &[[f32; 3]], tables: &LobeTables, sh_degree: usize) -> f32 {
        let whole = rendering_tables(&lobes.combined(weights), sh_degree);
        let all = 0..lobes.directions().len();
        let sum = |row: &[f32], c: usize| row.iter().zip(weights).map(|(t, w)| t * w[c]).sum::<f32>();
        let (mut found, mut expected) = (Vec::new(), Vec::new());
        for node in 0..whole.diffuse_grid.len() {
            for c in 0..3 {
                for j in 0..sh_count(sh_degree) {
                    found.push(sum(tables.diffuse(node, j, &all), c));
                    expected.push(whole.diffuse_rows(node)[c][j]);
                }
            }
        }
        for (level, nodes) in whole.specular.iter().enumerate() {
            for (node, radiance) in nodes.iter().enumerate() {
                found.extend([0, 1, 2].map(|c| sum(tables.specular(level, node, &all), c)));
                expected.extend(radiance);
            }
        }
        largest_difference(&found, &expected) as f32
    }

    #[test]
    fn tables_of_lobes_add_up_to_those_of_their_sum() {
        for (count, sh_degree) in [(5, 0), (40, 2)] {
            let lobes = LightLobes::new(count);
            let weights: Vec<[f32; 3]> =
                (0..count).map(|k| [((k * 7) % 5) as f32 * 0.25, 1.0, (k % 3) as f32 * 0.5]).collect();
            let tables = LobeTables::new(&lobes, sh_degree);
            let error = difference(&lobes, &weights, &tables, sh_degree);
            assert!(error < 2e-5, "{count} lobes: {error}");
            let one = |k: usize| std::array::from_fn(|_| f32::from(k == 3));
            let alone: Vec<[f32; 3]> = (0..count).map(one).collect();
            assert!(difference(&lobes, &alone, &tables, sh_degree) < 2e-5);
            // The control: another lobe.
            let all = 0..count;
            let apart = (0..17).any(|node| {
                let row = tables.diffuse(node, 0, &all);
                (row[3] - row[2]).abs() > 1e-3
            });
            assert!(apart);
        }
    }
}
