//! Light from tables (docs/MODEL.md, section 4): dense f64 operators on the texels, tabulated on cube grids of directions as in
//! `relume_scene::light`, and looked up with its weights.

use std::f64::consts::PI;

use super::array::Array;
use super::lighting::{DirectLight, Lighting};
use super::spherical::{real_sh, sh_degree_of};
use super::tape::Var;
use relume_scene::light::{BrdfLut, CubeGrid, LevelPosition, SPECULAR_LEVELS, TableResolution, ggx_d};
use relume_scene::{LightSplit, MAX_LIGHTS, SplitLight, texel_directions};

/// Number of prefiltered levels.
const LEVELS: usize = SPECULAR_LEVELS.len();

/// Operators from the texels of `width` x `height` environments to the nodes of the tables.
#[derive(Debug, Clone)]
pub struct TableOperators {
    /// Texel directions, (M, 3).
    directions: Array,
    diffuse: Operator,
    specular: Vec<Operator>,
    /// Solid angles of the texels.
    solid_angles: Vec<f64>,
    split: LightSplit,
}

/// One table: its nodes, and its linear operator on radiance, (nodes, M).
#[derive(Debug, Clone)]
struct Operator {
    grid: CubeGrid,
    weights: Array,
}

impl TableOperators {
    /// The operators for one size of environment, at one resolution of tables.
    pub fn new(width: usize, height: usize, resolution: TableResolution) -> Self {
        let texels = texel_directions(width, height);
        let cosine = |n: glam::DVec3| texels.iter().map(|(d, w)| n.dot(*d).max(0.0) * w).collect();
        // A lobe narrower than a texel could miss all texel centres.
        let smallest_alpha = 0.25 * PI / height as f64;
        let level = |(k, roughness): (usize, &f32)| {
            let nodes = if k < 2 { resolution.sharp } else { resolution.rough };
            let alpha = f64::from(*roughness).powi(2).max(smallest_alpha);
            Operator::new(CubeGrid::new(nodes), |r| {
                // GGX over the half vector of R and w with N = V = R, normalised.
                let weight = |(d, w): &(glam::DVec3, f64)| {
                    let cos = r.dot(*d).max(0.0);
                    ggx_d((0.5 + 0.5 * cos).sqrt(), alpha) * cos * w
                };
                let lobe: Vec<f64> = texels.iter().map(weight).collect();
                let total: f64 = lobe.iter().sum();
                lobe.into_iter().map(|w| w / total).collect()
            })
        };
        let rows: Vec<[f64; 3]> = texels.iter().map(|(d, _)| d.to_array()).collect();
        Self {
            directions: Array::from_rows(&rows),
            diffuse: Operator::new(CubeGrid::new(resolution.diffuse), cosine),
            specular: SPECULAR_LEVELS.iter().enumerate().map(level).collect(),
            solid_angles: texels.iter().map(|(_, w)| *w).collect(),
            split: LightSplit::default(),
        }
    }

    /// The same operators for environments with the dominant lights of `split`.
    #[must_use]
    pub fn with_lights(&self, split: &LightSplit) -> Self {
        Self { split: split.clone(), ..self.clone() }
    }

    /// The dominant lights of one `radiance`, (M, 3).
    fn lights<'t>(&self, radiance: Var<'t>) -> Vec<DirectLight<'t>> {
        let light = |(k, light): (usize, &SplitLight)| {
            let shares = self.split.shares.iter().zip(&self.solid_angles);
            let row: Vec<f64> = shares.map(|(m, w)| f64::from(m[k]) * w).collect();
            let row = radiance.tape.input(Array::new(&[1, row.len()], row));
            DirectLight {
                direction: light.direction.map(f64::from),
                radius: light.radius.into(),
                irradiance: row.matmul(radiance),
            }
        };
        self.split.lights.iter().enumerate().map(light).collect()
    }

    /// The rest of `radiance` without dominant lights, (M, 3).
    fn rest<'t>(&self, radiance: Var<'t>) -> Var<'t> {
        if self.split.is_empty() {
            return radiance;
        }
        let rest = |m: &[f32; MAX_LIGHTS]| [1.0 - m.iter().map(|v| f64::from(*v)).sum::<f64>()];
        let shares: Vec<[f64; 1]> = self.split.shares.iter().map(rest).collect();
        radiance * radiance.tape.input(Array::from_rows(&shares))
    }

    /// The tables of one `radiance`, (M, 3), for visibility up to degree `sh_degree`.
    pub fn under<'t>(&self, radiance: Var<'t>, sh_degree: usize) -> TabulatedEnvironment<'t> {
        let lights = self.lights(radiance);
        let radiance = self.rest(radiance);
        let tape = radiance.tape;
        let basis = real_sh(tape.input(self.directions.clone()), sh_degree);
        let [texels, coefficients] = [0, 1].map(|i| basis.value().shape()[i]);
        // Light that each coefficient passes, per colour.
        let products = radiance.reshaped(&[texels, 3, 1]) * basis.reshaped(&[texels, 1, coefficients]);
        let products = products.reshaped(&[texels, 3 * coefficients]);
        TabulatedEnvironment {
            diffuse: self.diffuse.apply(products),
            specular: self.specular.iter().map(|level| level.apply(radiance)).collect(),
            lights,
        }
    }
}

impl Operator {
    /// Tabulates `weights` of each node; entries below 1e-4 of the largest are dropped and the rest rescaled
    /// to the same sum, as in the sparse operators of `relume_scene::light`.
    fn new(grid: CubeGrid, weights: impl Fn(glam::DVec3) -> Vec<f64>) -> Self {
        let mut data = Vec::new();
        for node in grid.directions() {
            let dense = weights(node);
            let least = dense.iter().copied().fold(0.0, f64::max) * 1e-4;
            let kept: f64 = dense.iter().filter(|w| **w > least).sum();
            let scale = dense.iter().sum::<f64>() / kept.max(f64::MIN_POSITIVE);
            data.extend(dense.iter().map(|&w| if w > least { w * scale } else { 0.0 }));
        }
        let texels = data.len() / grid.len();
        Self { grid, weights: Array::new(&[grid.len(), texels], data) }
    }

    fn apply<'t>(&self, texels: Var<'t>) -> Table<'t> {
        Table { grid: self.grid, nodes: texels.tape.input(self.weights.clone()).matmul(texels) }
    }
}

/// Values (nodes, C) on a grid of directions.
struct Table<'t> {
    grid: CubeGrid,
    nodes: Var<'t>,
}

impl<'t> Table<'t> {
    /// Bilinear look-up along `directions` (P, 3): (P, C).
    fn at(&self, directions: Var<'t>) -> Var<'t> {
        let weights = directions.map_rows(|d: [f64; 3]| {
            let taps = self.grid.lookup(d);
            // A zero vector maps to a node but has no derivative.
            let gradient = if d == [0.0; 3] { [[0.0; 3]; 4] } else { taps.gradient };
            (taps.weight, gradient)
        });
        let rows = directions.value();
        let nodes = |corner: usize| -> Vec<usize> {
            let rows = rows.data().as_chunks::<3>().0.iter();
            rows.map(|d| self.grid.lookup(*d).node[corner]).collect()
        };
        let corner = |k: usize| weights.column(k) * self.nodes.gather(0, &nodes(k));
        corner(0) + corner(1) + corner(2) + corner(3)
    }
}

/// The [`TableOperators`] of one environment.
pub struct TabulatedEnvironment<'t> {
    /// Transfer `T_j(n)` per colour, (nodes, 3 (L + 1)^2).
    diffuse: Table<'t>,
    /// Prefiltered radiance per level, (nodes, 3).
    specular: Vec<Table<'t>>,
    lights: Vec<DirectLight<'t>>,
}

impl<'t> Lighting<'t> for TabulatedEnvironment<'t> {
    fn lights(&self) -> Vec<DirectLight<'t>> {
        self.lights.clone()
    }

    /// The first transfer coefficient, rescaled: V = 1 is `c_0 = 2 sqrt(pi)`.
    fn irradiance(&self, normals: Var<'t>) -> Var<'t> {
        let pixels = normals.value().shape()[0];
        let open = Array::filled(&[pixels, 1], 2.0 * PI.sqrt());
        self.transfer(normals, normals.tape.input(open))
    }

    fn transfer(&self, normals: Var<'t>, visibility: Var<'t>) -> Var<'t> {
        let [pixels, used] = [0, 1].map(|i| visibility.value().shape()[i]);
        assert!(sh_degree_of(visibility) <= 8, "visibility beyond degree 8");
        let transfer = self.diffuse.at(normals);
        let coefficients = transfer.value().shape()[1] / 3;
        let transfer = transfer.reshaped(&[pixels, 3, coefficients]).slice(2, 0..used);
        (transfer * visibility.reshaped(&[pixels, 1, used])).sum_last().reshaped(&[pixels, 3])
    }

    /// Linear interpolation of the levels by roughness.
    fn prefiltered(&self, directions: Var<'t>, roughness: Var<'t>) -> Var<'t> {
        let shares = roughness.map_rows(|[roughness]: [f64; 1]| {
            let LevelPosition { level, fraction, by_roughness: derivative } = LevelPosition::of(roughness);
            let (mut share, mut by_roughness) = ([0.0; LEVELS], [[0.0]; LEVELS]);
            (share[level], share[level + 1]) = (1.0 - fraction, fraction);
            (by_roughness[level], by_roughness[level + 1]) = ([-derivative], [derivative]);
            (share, by_roughness)
        });
        let level = |k: usize| shares.column(k) * self.specular[k].at(directions);
        (1..LEVELS).fold(level(0), |sum, k| sum + level(k))
    }

    fn brdf(&self, n_dot_v: Var<'t>, roughness: Var<'t>) -> Var<'t> {
        super::ops::concat(n_dot_v.tape, 1, &[n_dot_v, roughness]).map_rows(
            |[n_dot_v, roughness]: [f64; 2]| {
                let sample = BrdfLut::shared().sample(n_dot_v, roughness);
                (sample.value, std::array::from_fn(|k| [sample.by_nov[k], sample.by_roughness[k]]))
            },
        )
    }
}
