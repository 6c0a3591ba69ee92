//! Dominant lights on surfaces (docs/MODEL.md, section 4).

use std::f64::consts::PI;

use super::array::Array;
use super::lighting::DirectLight;
use super::tape::{Tape, Var};

/// Light of one dominant light at P surfaces.
pub struct Direct<'t> {
    /// Irradiance, (P, 3).
    pub irradiance: Var<'t>,
    /// Specular radiance, (P, 3).
    pub specular: Var<'t>,
}

/// Light that `light`, weighted by its share `arriving` (P, 1), adds at surfaces with the given unit normals turned to the
/// camera, directions to the camera, roughnesses and reflectances at normal incidence.
pub fn direct<'t>(
    tape: &'t Tape,
    light: &DirectLight<'t>,
    arriving: Var<'t>,
    (normal, view, n_dot_v): (Var<'t>, Var<'t>, Var<'t>),
    (rough, f0): (Var<'t>, Var<'t>),
) -> Direct<'t> {
    let count = normal.value().shape()[0];
    let towards = tape.input(Array::from_rows(&vec![light.direction; count]));
    let n_dot_w = normal.dot(towards).at_least(0.0);
    let half = (view + towards).normalised();
    let (n_dot_h, v_dot_h) = (normal.dot(half), view.dot(half));
    let alpha = (rough * rough).at_least(1e-4);
    let alpha2 = (alpha * alpha + 0.25 * light.radius * light.radius).at_most(1.0);
    let spread = n_dot_h * n_dot_h * (alpha2 - 1.0) + 1.0;
    let distribution = alpha2 / (PI * spread * spread);
    let root = |cosine: Var<'t>| (alpha2 + (1.0 - alpha2) * cosine * cosine).sqrt();
    // G / (4 n.v n.w), height-correlated, times n.w.
    let shadowing = 0.5 * n_dot_w / (n_dot_v * root(n_dot_w) + n_dot_w * root(n_dot_v));
    let fresnel = f0 + (1.0 - f0) * (1.0 - v_dot_h).at_least(0.0).powi(5);
    let arriving = arriving * light.irradiance;
    Direct { irradiance: arriving * n_dot_w, specular: arriving * distribution * shadowing * fresnel }
}
