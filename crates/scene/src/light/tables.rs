//! Look-up tables for shading: an environment after the linear operators.

use crate::light::{CubeGrid, SPECULAR_LEVELS};
use crate::{MAX_LIGHTS, SplitLight};

/// Visibility coefficients are padded with zeros to a multiple of this, so that dot products use whole vectors.
pub const TABLE_LANES: usize = 16;

/// `n` rounded up to a multiple of [`TABLE_LANES`].
pub const fn padded(n: usize) -> usize {
    n.div_ceil(TABLE_LANES) * TABLE_LANES
}

/// Diffuse transfer and prefiltered radiance of one environment; also the shape of their gradients.
#[derive(Debug, Clone, PartialEq)]
pub struct LightTables {
    /// Grid of normals.
    pub diffuse_grid: CubeGrid,
    /// Padded number of visibility coefficients per colour in `diffuse`.
    pub coefficients: usize,
    /// `T_j(n)`, irradiance at normal n through visibility `Y_j` alone (docs/MODEL.md section 4), as `[node][rgb][coefficient]`, W/m^2 per unit coefficient.
    pub diffuse: Vec<f32>,
    /// Grid of reflection directions, per level.
    pub specular_grids: [CubeGrid; SPECULAR_LEVELS.len()],
    /// Prefiltered radiance `[node]` per level of [`SPECULAR_LEVELS`].
    pub specular: [Vec<[f32; 3]>; SPECULAR_LEVELS.len()],
    /// Dominant lights, which the tables do not contain.
    pub lights: Vec<TableLight>,
}

impl From<&TableLight> for SplitLight {
    fn from(light: &TableLight) -> Self {
        Self { direction: light.direction, radius: light.radius }
    }
}

/// A distant small light, whose shadow is measured separately.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TableLight {
    /// Unit direction towards it.
    pub direction: [f32; 3],
    /// Angular radius, radians.
    pub radius: f32,
    /// Irradiance of a surface that faces it, RGB, W/m^2. In gradient tables: the gradient by that irradiance.
    pub irradiance: [f32; 3],
}

impl LightTables {
    /// Zeroed tables of the same shape, for the accumulation of gradients.
    #[must_use]
    pub fn zeroed(&self) -> Self {
        Self {
            diffuse: vec![0.0; self.diffuse.len()],
            specular: std::array::from_fn(|k| vec![[0.0; 3]; self.specular[k].len()]),
            lights: self.lights.iter().map(|l| TableLight { irradiance: [0.0; 3], ..*l }).collect(),
            ..*self
        }
    }

    /// Adds tables of the same shape, entry by entry.
    pub fn accumulate(&mut self, other: &Self) {
        self.diffuse.iter_mut().zip(&other.diffuse).for_each(|(a, b)| *a += b);
        for (mine, theirs) in self.specular.iter_mut().zip(&other.specular) {
            for (a, b) in mine.iter_mut().zip(theirs) {
                (0..3).for_each(|k| a[k] += b[k]);
            }
        }
        for (mine, theirs) in self.lights.iter_mut().zip(&other.lights) {
            (0..3).for_each(|k| mine.irradiance[k] += theirs.irradiance[k]);
        }
    }

    /// All values in the order in which shaders read them: diffuse transfer, the specular levels, then the irradiance RGB of
    /// [`MAX_LIGHTS`] lights, zero beyond the last.
    pub fn flat(&self) -> Vec<f32> {
        let levels = self.specular.iter().flatten().flatten();
        let lights = self.lights.iter().flat_map(|l| &l.irradiance).chain(std::iter::repeat(&0.0));
        self.diffuse.iter().chain(levels).chain(lights.take(3 * MAX_LIGHTS)).copied().collect()
    }

    /// The three padded coefficient rows of `node`: red, green, blue.
    #[inline]
    pub fn diffuse_rows(&self, node: usize) -> [&[f32]; 3] {
        let n = self.coefficients;
        let at = |c: usize| &self.diffuse[(node * 3 + c) * n..(node * 3 + c + 1) * n];
        [at(0), at(1), at(2)]
    }
}
