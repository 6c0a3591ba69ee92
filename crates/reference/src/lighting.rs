//! Interface between shading and an environment, with two implementations: the listing's quadrature and the tables of
//! docs/MODEL.md.

use super::tape::Var;

/// A distant small light.
#[derive(Clone, Copy)]
pub struct DirectLight<'t> {
    /// Unit direction towards it.
    pub direction: [f64; 3],
    /// Angular radius, radians.
    pub radius: f64,
    /// Irradiance of a surface that faces it, (1, 3).
    pub irradiance: Var<'t>,
}

/// An environment on the tape, with the tables of the BRDF.
pub trait Lighting<'t> {
    /// Irradiance `int L(w) (n.w)+ dw` (Eq. 7) at unit normals (P, 3): (P, 3).
    fn irradiance(&self, normals: Var<'t>) -> Var<'t>;

    /// `int V(w) L(w) (n.w)+ dw` for visibility coefficients (P, (L + 1)^2) at unit normals (P, 3): (P, 3).
    fn transfer(&self, normals: Var<'t>, visibility: Var<'t>) -> Var<'t>;

    /// Radiance averaged over the specular lobe of roughness (P, 1) around unit directions (P, 3): (P, 3).
    fn prefiltered(&self, directions: Var<'t>, roughness: Var<'t>) -> Var<'t>;

    /// Split-sum scale and offset of F0 at n.v and roughness, each (P, 1): (P, 2).
    fn brdf(&self, n_dot_v: Var<'t>, roughness: Var<'t>) -> Var<'t>;

    /// Dominant lights, which the other methods do not contain.
    fn lights(&self) -> Vec<DirectLight<'t>> {
        Vec::new()
    }
}
