//! Light tables for rendering under a map of any size, built once per map.
//!
//! The training operators are explicit matrices over few texels. A 4k map would need matrices of gigabytes, so this module
//! evaluates the same kernels directly: the diffuse transfer by quadrature over a reduced map, the specular levels by
//! importance sampling of the lobe. Each sample is read from the map's pyramid at the level of its solid angle.

use std::borrow::Cow;

use glam::{DVec3, Vec3, Vec4};
use multiversion::multiversion;
use rayon::prelude::*;

use crate::light::map_rows::DIFFUSE_ROWS;
use crate::light::reflection_lobe::{Places, ReflectionLobe};
use crate::light::{CubeGrid, LightTables, SPECULAR_LEVELS, padded, sh_eval};
use crate::{EnvMap, sh_count, texel_directions};

/// Nodes along a cube edge for normals.
pub(super) const DIFFUSE_NODES: usize = 17;
/// Nodes along a cube edge for each specular level.
pub(super) const SPECULAR_NODES: [usize; SPECULAR_LEVELS.len()] = [65, 33, 33, 17, 17, 17];
/// The tables of `map` for visibility fields of degree `sh_degree`.
pub fn rendering_tables(map: &EnvMap, sh_degree: usize) -> LightTables {
    let diffuse_grid = CubeGrid::new(DIFFUSE_NODES);
    let pyramid = Pyramid::new(map);
    let specular_grids = SPECULAR_NODES.map(CubeGrid::new);
    let specular = std::array::from_fn(|k| {
        let lobe = ReflectionLobe::new(k, &pyramid.sizes());
        let nodes = specular_grids[k].directions().into_par_iter();
        nodes.map_init(Places::default, |places, r| pyramid.filtered(r, &lobe, places)).collect()
    });
    LightTables {
        diffuse_grid,
        coefficients: padded(sh_count(sh_degree)),
        diffuse: diffuse_transfer(&diffuse_grid, map, sh_degree),
        specular_grids,
        specular,
        lights: Vec::new(),
    }
}

/// `T_j(n) = int Y_j L (n . w)+ dw` at each node.
fn diffuse_transfer(grid: &CubeGrid, map: &EnvMap, sh_degree: usize) -> Vec<f32> {
    let small;
    let map = if map.height() > DIFFUSE_ROWS {
        small = map.resampled(2 * DIFFUSE_ROWS, DIFFUSE_ROWS);
        &small
    } else {
        map
    };
    let n = padded(sh_count(sh_degree));
    let directions = texel_directions(map.width(), map.height());
    let mut products = vec![0.0f32; directions.len() * 3 * n];
    for (((d, w), l), rows) in directions.iter().zip(map.texels()).zip(products.chunks_exact_mut(3 * n)) {
        let (y, others) = rows.split_at_mut(n);
        sh_eval(sh_degree, d.to_array().map(|v| v as f32), y);
        let light = l.map(|l| l * *w as f32);
        for (row, light) in others.chunks_exact_mut(n).zip(&light[1..]) {
            row.iter_mut().zip(&*y).for_each(|(product, y)| *product = y * light);
        }
        y.iter_mut().for_each(|y| *y *= light[0]);
    }
    let directions: Vec<Vec3> = directions.iter().map(|(d, _)| d.as_vec3()).collect();
    let nodes = grid.directions();
    let mut out = vec![0.0f32; nodes.len() * 3 * n];
    out.par_chunks_mut(3 * n)
        .zip(&nodes)
        .for_each(|(row, node)| add_products(node.as_vec3(), &directions, &products, row));
    out
}

/// Adds to `row` the rows of `products`, one per direction, times the clamped cosine between `normal` and the direction.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+fma", "x86_64+avx2+fma", "aarch64+neon"))]
fn add_products(normal: Vec3, directions: &[Vec3], products: &[f32], row: &mut [f32]) {
    let width = row.len().max(1);
    for (direction, light) in directions.iter().zip(products.chunks_exact(width)) {
        let cos = normal.dot(*direction);
        if cos > 0.0 {
            row.iter_mut().zip(light).for_each(|(sum, light)| *sum += cos * light);
        }
    }
}

/// A map and its reductions by two.
struct Pyramid {
    levels: Vec<Level>,
}

/// A map of texels that the processor loads as whole vectors.
struct Level {
    size: (usize, usize),
    texels: Vec<Vec4>,
}

impl From<&EnvMap> for Level {
    fn from(map: &EnvMap) -> Self {
        let texels = map.texels().iter().map(|[r, g, b]| Vec4::new(*r, *g, *b, 0.0)).collect();
        Self { size: (map.width(), map.height()), texels }
    }
}

/// Whether a map of `rows` rows has a coarser level in a pyramid.
pub(super) fn has_coarser_level(rows: usize) -> bool {
    rows > 4
}

impl Pyramid {
    fn new(map: &EnvMap) -> Self {
        let mut levels = vec![Level::from(map)];
        let mut last = Cow::Borrowed(map);
        while has_coarser_level(last.height()) {
            last = Cow::Owned(last.resampled((last.width() / 2).max(1), (last.height() / 2).max(1)));
            levels.push(Level::from(&*last));
        }
        Self { levels }
    }

    /// Columns and rows of each level.
    fn sizes(&self) -> Vec<(usize, usize)> {
        self.levels.iter().map(|level| level.size).collect()
    }

    /// Mean radiance over the lobe around `r`.
    fn filtered(&self, r: DVec3, lobe: &ReflectionLobe, places: &mut Places) -> [f32; 3] {
        lobe.places_around(r, places);
        let mut sum = Vec4::ZERO;
        for (tap, (u, v)) in lobe.taps.iter().zip(places.u.iter().zip(&places.v)) {
            let fine = bilinear(&self.levels[tap.low], [*u, *v]);
            let coarse = bilinear(&self.levels[(tap.low + 1).min(self.levels.len() - 1)], [*u, *v]);
            sum += tap.weight * fine.lerp(coarse, tap.fraction);
        }
        sum.truncate().to_array()
    }
}

/// The four texels around a point of a map, and its position between them.
pub(super) struct Cell {
    /// Upper left, upper right, lower left, lower right.
    pub(super) texels: [usize; 4],
    /// From left to right, 0 to 1.
    pub(super) across: f32,
    /// From top to bottom, 0 to 1.
    pub(super) down: f32,
}

impl Cell {
    /// Around `u` in [0, 1] and `v` in [0, 1] of a map of `width` x `height` texels.
    #[inline(always)]
    pub(super) fn around((width, height): (usize, usize), [u, v]: [f32; 2]) -> Self {
        let x = u * width as f32 + (width as f32 - 0.5);
        let y = (v * height as f32 - 0.5).clamp(0.0, (height - 1) as f32);
        let (left, top) = (x as usize, y as usize);
        let (across, down) = (x - left as f32, y - top as f32);
        let around = |x: usize| if x >= width { x - width } else { x };
        let left = around(left);
        let (right, bottom) = (around(left + 1), (top + 1).min(height - 1));
        let at = |x: usize, y: usize| y * width + x;
        Self { texels: [at(left, top), at(right, top), at(left, bottom), at(right, bottom)], across, down }
    }
}

/// [`EnvMap::sample`] in single precision, at `u` in [0, 1] and `v` in [0, 1].
#[inline]
fn bilinear(level: &Level, uv: [f32; 2]) -> Vec4 {
    let Cell { texels, across, down } = Cell::around(level.size, uv);
    let [upper_left, upper_right, lower_left, lower_right] = texels.map(|t| level.texels[t]);
    upper_left.lerp(upper_right, across).lerp(lower_left.lerp(lower_right, across), down)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::{EnvOperators, TableResolution};
    use relume_compare::{largest_difference, worst};

    fn map() -> EnvMap {
        EnvMap::from_fn(64, 32, |d| {
            let sun = (40.0 * (d.dot(DVec3::new(0.6, 0.0, 0.8)) - 1.0)).exp();
            [(8.0 * sun + 0.3) as f32, (5.0 * sun + 0.4) as f32, (0.6 + 0.4 * d.z) as f32]
        })
    }

    #[test]
    fn importance_sampling_agrees_with_the_explicit_operators() {
        let fast = rendering_tables(&map(), 4);
        let exact = EnvOperators::new(64, 32, 4, TableResolution { diffuse: 9, sharp: 9, rough: 9 });
        let exact = exact.apply(map().texels());
        for k in 2..SPECULAR_LEVELS.len() {
            for (node, d) in exact.specular_grids[k].directions().iter().enumerate() {
                let taps = fast.specular_grids[k].lookup(d.to_array().map(|v| v as f32));
                for c in 0..3 {
                    let got: f32 = (0..4).map(|j| taps.weight[j] * fast.specular[k][taps.node[j]][c]).sum();
                    let want = exact.specular[k][node][c];
                    assert!((got - want).abs() < 0.06 * want + 0.02, "level {k} {d} {got} {want}");
                }
            }
        }
        for (node, d) in exact.diffuse_grid.directions().iter().enumerate() {
            let taps = fast.diffuse_grid.lookup(d.to_array().map(|v| v as f32));
            for c in 0..3 {
                let rows = taps.node.map(|n| fast.diffuse_rows(n)[c][0]);
                let got: f32 = (0..4).map(|j| taps.weight[j] * rows[j]).sum();
                let want = exact.diffuse_rows(node)[c][0];
                assert!((got - want).abs() < 0.01 * want, "{d} {got} {want}");
            }
        }
    }

    #[test]
    fn pyramid_lookup_matches_the_map_sampling() {
        let map =
            EnvMap::from_fn(61, 31, |d| [(9.0 * d.x).sin() as f32 + 1.5, d.y as f32 + 1.5, d.z as f32 + 1.5]);
        let level = Level::from(&map);
        let error = |turn: f64| {
            let directions = crate::texel_directions(80, 40).into_iter();
            let differences = directions.map(|(d, _)| {
                let expected = map.sample(glam::DQuat::from_rotation_z(turn) * d);
                let found =
                    bilinear(&level, crate::direction_to_uv(d).map(|v| v as f32)).truncate().to_array();
                largest_difference(&found, &expected)
            });
            worst(differences)
        };
        assert!(error(0.0) < 1e-3, "{}", error(0.0));
        assert!(error(0.01) > 1e-2, "the control: half a degree shows");
    }

    #[test]
    fn tables_differ_for_a_rotated_light() {
        let turned = map().rotated_and_scaled(120.0, 1.0);
        let (a, b) = (rendering_tables(&map(), 0), rendering_tables(&turned, 0));
        let most = largest_difference(&a.diffuse, &b.diffuse);
        assert!(most.is_finite() && most > 0.1, "{most}");
    }
}
