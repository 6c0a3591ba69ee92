//! Light by quadrature over the texels of an environment, as in the article's listing.

use std::f64::consts::PI;

use super::array::Array;
use super::lighting::Lighting;
use super::spherical::{real_sh, sh_degree_of};
use super::tape::Var;

/// The fixed tables of the quadrature.
#[derive(Debug, Clone, PartialEq)]
pub struct Quadrature {
    /// Unit directions of the M environment texels, (M, 3).
    pub directions: Array,
    /// Their solid angles, steradian, (1, M).
    pub solid_angles: Array,
    /// Split-sum table indexed channel, roughness, n.v: (2, R, R).
    pub brdf: Array,
}

/// Smallest GGX alpha that the texels resolve.
const MIN_GGX_ALPHA: f64 = 0.02;

impl Quadrature {
    /// The quadrature of one `radiance`, (M, 3).
    pub fn under<'t>(&self, radiance: Var<'t>) -> QuadratureLight<'t> {
        let tape = radiance.tape;
        QuadratureLight {
            directions: tape.input(self.directions.clone()),
            solid_angles: tape.input(self.solid_angles.clone()),
            brdf: self.brdf.clone(),
            radiance,
        }
    }
}

/// A [`Quadrature`] of one environment.
pub struct QuadratureLight<'t> {
    directions: Var<'t>,
    solid_angles: Var<'t>,
    brdf: Array,
    radiance: Var<'t>,
}

impl<'t> QuadratureLight<'t> {
    /// Cosines between rows (P, 3) and every texel, (P, M), 0 below the horizon.
    fn cosines(&self, rows: Var<'t>) -> Var<'t> {
        rows.matmul(self.directions.transposed()).at_least(0.0)
    }
}

impl<'t> Lighting<'t> for QuadratureLight<'t> {
    fn irradiance(&self, normals: Var<'t>) -> Var<'t> {
        (self.cosines(normals) * self.solid_angles).matmul(self.radiance)
    }

    fn transfer(&self, normals: Var<'t>, visibility: Var<'t>) -> Var<'t> {
        let basis = real_sh(self.directions, sh_degree_of(visibility));
        let seen = visibility.matmul(basis.transposed());
        (self.cosines(normals) * self.solid_angles * seen).matmul(self.radiance)
    }

    /// The article's lobe: GGX of the angle to the reflected direction itself.
    fn prefiltered(&self, directions: Var<'t>, roughness: Var<'t>) -> Var<'t> {
        let cosines = self.cosines(directions);
        let alpha = (roughness * roughness).at_least(MIN_GGX_ALPHA);
        let lobe = ggx(cosines, alpha) * cosines * self.solid_angles;
        lobe.matmul(self.radiance) / (lobe.sum_last() + 1e-8)
    }

    /// Bilinear, constant beyond the border.
    fn brdf(&self, n_dot_v: Var<'t>, roughness: Var<'t>) -> Var<'t> {
        bilinear(&self.brdf, n_dot_v, roughness)
    }
}

/// GGX normal distribution at the cosine to the half vector.
fn ggx<'t>(cosine: Var<'t>, alpha: Var<'t>) -> Var<'t> {
    let a2 = alpha * alpha;
    let denominator = cosine * cosine * (a2 - 1.0) + 1.0;
    a2 / (PI * denominator * denominator + 1e-8)
}

/// Looks up `table` (C, rows, columns) whose texel centres lie at (i + 0.5) / size, at `u` along the columns
/// and `v` along the rows, each (P, 1) in [0, 1]: (P, C).
fn bilinear<'t>(table: &Array, u: Var<'t>, v: Var<'t>) -> Var<'t> {
    let [channels, rows, columns] = [0, 1, 2].map(|i| table.shape()[i]);
    let (x, y) = (u * columns as f64 - 0.5, v * rows as f64 - 0.5);
    let (x, y) = (x.clamp(0.0, (columns - 1) as f64), y.clamp(0.0, (rows - 1) as f64));
    let cell = |at: Var<'t>, size: usize| at.value().map(|a| a.floor().min((size.max(2) - 2) as f64));
    let (x0, y0) = (cell(x, columns), cell(y, rows));
    let corner = |dx: usize, dy: usize| {
        let mut values = Vec::with_capacity(x0.len() * channels);
        for (x0, y0) in x0.data().iter().zip(y0.data()) {
            let (i, j) = ((*x0 as usize + dx).min(columns - 1), (*y0 as usize + dy).min(rows - 1));
            values.extend((0..channels).map(|c| table.data()[(c * rows + j) * columns + i]));
        }
        u.tape.input(Array::new(&[x0.len(), channels], values))
    };
    let (fx, fy) = (x - u.tape.input(x0.clone()), y - u.tape.input(y0.clone()));
    let along = |dy| corner(0, dy) * (1.0 - fx) + corner(1, dy) * fx;
    along(0) * (1.0 - fy) + along(1) * fy
}
