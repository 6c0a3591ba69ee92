//! Light tables for rendering under a map of any size, built once per map.
//!
//! The training operators are explicit matrices over few texels. A 4k map would need matrices of gigabytes, so this module
//! evaluates the same kernels directly: the diffuse transfer by quadrature over a reduced map, the specular levels by
//! importance sampling of the lobe. Each sample is read from the map's pyramid at the level of its solid angle.

use std::f32::consts::TAU;
use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::light::map_rows::DIFFUSE_ROWS;
use crate::light::{CubeGrid, LightTables, SPECULAR_LEVELS, brdf::ggx_d, padded, sh_eval};
use crate::{EnvMap, sh_count, texel_directions};

/// Nodes along a cube edge for normals.
pub(super) const DIFFUSE_NODES: usize = 17;
/// Nodes along a cube edge for each specular level.
pub(super) const SPECULAR_NODES: [usize; SPECULAR_LEVELS.len()] = [65, 33, 33, 17, 17, 17];
/// Lobe samples per node.
const SAMPLES: u32 = 192;

/// The tables of `map` for visibility fields of degree `sh_degree`.
pub fn rendering_tables(map: &EnvMap, sh_degree: usize) -> LightTables {
    let diffuse_grid = CubeGrid::new(DIFFUSE_NODES);
    let pyramid = Pyramid::new(map);
    let specular_grids = SPECULAR_NODES.map(CubeGrid::new);
    let specular = std::array::from_fn(|k| {
        let alpha = f64::from(SPECULAR_LEVELS[k]).powi(2);
        let lobe = lobe_taps(alpha, &pyramid.sizes());
        specular_grids[k].directions().into_par_iter().map(|r| pyramid.filtered(r, &lobe)).collect()
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
    let products: Vec<f32> = directions
        .iter()
        .zip(map.texels())
        .flat_map(|((d, w), l)| {
            let mut y = vec![0.0f32; n];
            sh_eval(sh_degree, d.to_array().map(|v| v as f32), &mut y);
            let weight = *w as f32;
            let l = *l;
            (0..3).flat_map(move |c| y.clone().into_iter().map(move |y| y * l[c] * weight))
        })
        .collect();
    let nodes = grid.directions();
    let mut out = vec![0.0f32; nodes.len() * 3 * n];
    out.par_chunks_mut(3 * n).zip(&nodes).for_each(|(row, node)| {
        for ((d, _), light) in directions.iter().zip(products.chunks_exact(3 * n)) {
            let cos = node.dot(*d) as f32;
            if cos > 0.0 {
                row.iter_mut().zip(light).for_each(|(o, v)| *o += cos * v);
            }
        }
    });
    out
}

/// One sample of the lobe around +Z: direction, weight, solid angle.
struct LobeDirection {
    direction: DVec3,
    weight: f64,
    solid_angle: f64,
}

/// Samples of `D(half) cos` with N = V = R, weights summing to 1.
fn lobe_samples(alpha: f64) -> Vec<LobeDirection> {
    let mut out: Vec<LobeDirection> = (0..SAMPLES)
        .filter_map(|i| {
            let u1 = (f64::from(i) + 0.5) / f64::from(SAMPLES);
            let u2 = (f64::from(i.reverse_bits()) + 0.5) / 4_294_967_296.0;
            let cos_h = ((1.0 - u2) / (1.0 + (alpha * alpha - 1.0) * u2)).sqrt();
            let sin_h = (1.0 - cos_h * cos_h).max(0.0).sqrt();
            let phi = 2.0 * PI * u1;
            let h = DVec3::new(sin_h * phi.cos(), sin_h * phi.sin(), cos_h);
            let direction = 2.0 * cos_h * h - DVec3::Z;
            // The density of the reflected direction is D(h) cos_h / (4 cos_h).
            let density = 0.25 * ggx_d(cos_h, alpha);
            let solid_angle = 1.0 / (f64::from(SAMPLES) * density.max(1e-12));
            (direction.z > 0.0).then_some(LobeDirection { direction, weight: direction.z, solid_angle })
        })
        .collect();
    let total: f64 = out.iter().map(|s| s.weight).sum();
    out.iter_mut().for_each(|s| s.weight /= total);
    out
}

/// A map and its reductions by two.
struct Pyramid {
    levels: Vec<EnvMap>,
}

/// A sample of a lobe, read between level `low` of a pyramid and the next coarser one.
pub(super) struct Tap {
    pub(super) direction: Vec3,
    pub(super) weight: f32,
    pub(super) low: usize,
    pub(super) fraction: f32,
}

/// Samples of the lobe of `alpha` around +Z, with their positions in a pyramid of maps of these sizes.
pub(super) fn lobe_taps(alpha: f64, sizes: &[(usize, usize)]) -> Vec<Tap> {
    let texel = 4.0 * PI / (sizes[0].0 * sizes[0].1) as f64;
    let tap = |s: LobeDirection| {
        // One level coarser than the sample's footprint, so that neighbouring samples overlap.
        let level = (0.5 * (s.solid_angle / texel).log2() + 1.0).clamp(0.0, (sizes.len() - 1) as f64);
        let (low, fraction) = (level as usize, level.fract() as f32);
        Tap { direction: s.direction.as_vec3(), weight: s.weight as f32, low, fraction }
    };
    lobe_samples(alpha).into_iter().map(tap).collect()
}

/// Whether a map of `rows` rows has a coarser level in a pyramid.
pub(super) fn has_coarser_level(rows: usize) -> bool {
    rows > 4
}

impl Pyramid {
    fn new(map: &EnvMap) -> Self {
        let mut levels = vec![map.clone()];
        while let Some(last) = levels.last() {
            if !has_coarser_level(last.height()) {
                break;
            }
            let next = last.resampled((last.width() / 2).max(1), (last.height() / 2).max(1));
            levels.push(next);
        }
        Self { levels }
    }

    /// Columns and rows of each level.
    fn sizes(&self) -> Vec<(usize, usize)> {
        self.levels.iter().map(|map| (map.width(), map.height())).collect()
    }

    /// Mean radiance over the lobe around `r`.
    fn filtered(&self, r: DVec3, lobe: &[Tap]) -> [f32; 3] {
        let r = r.as_vec3();
        let (u, v) = r.any_orthonormal_pair();
        let mut sum = Vec3::ZERO;
        for tap in lobe {
            let uv = to_uv(tap.direction.x * u + tap.direction.y * v + tap.direction.z * r);
            let fine = bilinear(&self.levels[tap.low], uv);
            let coarse = bilinear(&self.levels[(tap.low + 1).min(self.levels.len() - 1)], uv);
            sum += tap.weight * fine.lerp(coarse, tap.fraction);
        }
        sum.to_array()
    }
}

/// [`direction_to_uv`](crate::direction_to_uv) in single precision, accurate to 1/10,000 of a texel of the largest maps.
pub(super) fn to_uv(d: Vec3) -> [f32; 2] {
    [0.5 - d.y.atan2(d.x) / TAU, d.z.clamp(-1.0, 1.0).acos() / (0.5 * TAU)]
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
fn bilinear(map: &EnvMap, uv: [f32; 2]) -> Vec3 {
    let Cell { texels, across, down } = Cell::around((map.width(), map.height()), uv);
    let [upper_left, upper_right, lower_left, lower_right] = texels.map(|t| Vec3::from(map.texels()[t]));
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
        let error = |turn: f64| {
            let directions = crate::texel_directions(80, 40).into_iter();
            let differences = directions.map(|(d, _)| {
                let expected = map.sample(glam::DQuat::from_rotation_z(turn) * d);
                largest_difference(&bilinear(&map, to_uv(d.as_vec3())).to_array(), &expected)
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
