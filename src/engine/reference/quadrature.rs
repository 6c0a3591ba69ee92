//! Light by plain quadrature over the texels of an environment, as the article's listing does it.

use std::f64::consts::PI;

use super::array::Array;
use super::tape::{Tape, Var};

/// The fixed tables of the quadrature.
#[derive(Debug, Clone, PartialEq)]
pub struct Quadrature {
    /// Unit directions of the M environment texels, (M, 3).
    pub directions: Array,
    /// Their solid angles, steradian, (1, M).
    pub solid_angles: Array,
    /// Split-sum table indexed channel, roughness, n.v: (2, R, R).
    pub brdf: Array,
    /// Directions at which indirect light samples the low-frequency environment, (D, 3).
    pub indirect_directions: Array,
}

/// Smallest GGX alpha the texels can resolve.
const SMALLEST_ALPHA: f64 = 0.02;

impl Quadrature {
    /// Cosines between rows (P, 3) and every texel, (P, M), 0 below the horizon.
    fn cosines<'t>(&self, rows: Var<'t>) -> Var<'t> {
        rows.matmul(rows.tape.input(self.directions.transposed())).at_least(0.0)
    }

    /// Irradiance `int L(w) (n.w)+ dw` (Eq. 7) of `radiance` (M, 3) at unit normals (P, 3).
    pub fn irradiance<'t>(&self, radiance: Var<'t>, normals: Var<'t>) -> Var<'t> {
        (self.cosines(normals) * normals.tape.input(self.solid_angles.clone())).matmul(radiance)
    }

    /// Radiance averaged over the GGX lobe of roughness (P, 1) around unit directions (P, 3).
    pub fn prefiltered<'t>(&self, radiance: Var<'t>, directions: Var<'t>, roughness: Var<'t>) -> Var<'t> {
        let cosines = self.cosines(directions);
        let alpha = (roughness * roughness).at_least(SMALLEST_ALPHA);
        let lobe = ggx(cosines, alpha) * cosines * directions.tape.input(self.solid_angles.clone());
        lobe.matmul(radiance) / (lobe.sum_last() + 1e-8)
    }

    /// Scale and offset of F0 at n.v and roughness (each (P, 1)), bilinear, constant past the border: (P, 2).
    pub fn brdf<'t>(&self, n_dot_v: Var<'t>, roughness: Var<'t>) -> Var<'t> {
        bilinear(&self.brdf, n_dot_v, roughness)
    }

    /// Directions at which indirect light samples the environment, (D, 3).
    pub fn indirect_directions<'t>(&self, tape: &'t Tape) -> Var<'t> {
        tape.input(self.indirect_directions.clone())
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
