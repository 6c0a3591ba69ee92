//! The G-buffer: per-Gaussian attributes blended into screen space, article section "deferred shading".

use super::compositing::Weights;
use super::ops::concat;
use super::projection::Splats;
use super::scene::Parameters;
use super::tape::{Tape, Var};
use crate::scene::Field;

/// Attributes of P pixels, divided by accumulated alpha.
pub struct GBuffer<'t> {
    /// Blended normal before normalisation, (P, 3).
    pub normal: Var<'t>,
    /// Albedo, (P, 3).
    pub albedo: Var<'t>,
    /// Metalness, (P, 1).
    pub metal: Var<'t>,
    /// Roughness, (P, 1).
    pub rough: Var<'t>,
    /// Visibility SH coefficients, (P, (L + 1)^2).
    pub visibility: Var<'t>,
    /// Light that comes from blocked directions, (P, 3).
    pub indirect: Var<'t>,
}

/// Blends the attributes of `splats`; `normals` and `indirect` are (N, 3), one row a Gaussian.
pub fn blend<'t>(
    tape: &'t Tape,
    p: &Parameters<'t>,
    splats: &Splats<'t>,
    weights: &Weights<'t>,
    normals: Var<'t>,
    indirect: Var<'t>,
) -> GBuffer<'t> {
    let attributes = [
        normals,
        p.albedo(),
        p.get(Field::MetalLogit).sigmoid(),
        p.get(Field::RoughLogit).sigmoid(),
        indirect,
        p.get(Field::Visibility),
    ];
    let attributes = concat(tape, 1, &attributes).gather(0, &splats.indices);
    let blended = weights.weights.matmul(attributes) / weights.alpha.at_least(1e-6);
    let channels = blended.value().shape()[1];
    let part = |range| blended.slice(1, range);
    GBuffer {
        normal: part(0..3),
        albedo: part(3..6),
        metal: part(6..7),
        rough: part(7..8),
        indirect: part(8..11),
        visibility: part(11..channels),
    }
}
