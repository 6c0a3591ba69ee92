//! The G-buffer: per-Gaussian attributes blended into screen space (docs/MODEL.md section 3).

use super::compositing::Weights;
use super::projection::Splats;
use super::scene::Parameters;
use super::tape::Var;
use crate::scene::Field;

/// Attributes of N Gaussians that depend on more than their material.
pub struct Attributes<'t> {
    /// Unit normal, (N, 3).
    pub normal: Var<'t>,
    /// Signed distance of the splat's plane from the camera, (N, 1).
    pub plane: Var<'t>,
    /// Colour of the radiance branch, display-referred, (N, 3).
    pub radiance: Var<'t>,
    /// Irradiance gathered from other Gaussians or, with [`ShadeAt::Gaussian`](crate::scene::ShadeAt), the radiance that
    /// leaves for the camera, (N, 3).
    pub light: Var<'t>,
    /// Radiance that comes from blocked directions or the specular part of what leaves, (N, 3).
    pub indirect: Var<'t>,
}

/// Attributes of P pixels, divided by coverage where not said otherwise.
pub struct GBuffer<'t> {
    /// Coverage itself, (P, 1).
    pub coverage: Var<'t>,
    /// Blended normal, not of unit length, (P, 3).
    pub normal: Var<'t>,
    /// Plane distance, (P, 1).
    pub plane: Var<'t>,
    /// Camera depth, (P, 1).
    pub depth: Var<'t>,
    /// Albedo, (P, 3).
    pub albedo: Var<'t>,
    /// Metalness, (P, 1).
    pub metal: Var<'t>,
    /// Roughness, (P, 1).
    pub rough: Var<'t>,
    /// Colour of the radiance branch, *not* divided by coverage, (P, 3).
    pub radiance: Var<'t>,
    /// As [`Attributes::light`], (P, 3).
    pub light: Var<'t>,
    /// As [`Attributes::indirect`], (P, 3).
    pub indirect: Var<'t>,
    /// Visibility SH coefficients, (P, (L + 1)^2).
    pub visibility: Var<'t>,
}

/// Smallest coverage attributes are divided by.
const LEAST_COVERAGE: f64 = 1e-6;

/// Blends the attributes of the splats' Gaussians.
pub fn blend<'t>(
    p: &Parameters<'t>,
    splats: &Splats<'t>,
    weights: &Weights<'t>,
    attributes: &Attributes<'t>,
) -> GBuffer<'t> {
    let sums = |of: Var<'t>| weights.weights.matmul(of.gather(0, &splats.indices));
    let coverage = weights.alpha;
    let divisor = coverage.at_least(LEAST_COVERAGE);
    let mean = |of: Var<'t>| sums(of) / divisor;
    GBuffer {
        coverage,
        normal: mean(attributes.normal),
        plane: mean(attributes.plane),
        depth: weights.weights.matmul(splats.depths) / divisor,
        albedo: mean(p.albedo()),
        metal: mean(p.get(Field::MetalLogit).sigmoid()),
        rough: mean(p.get(Field::RoughLogit).sigmoid()),
        radiance: sums(attributes.radiance),
        light: mean(attributes.light),
        indirect: mean(attributes.indirect),
        visibility: mean(p.get(Field::Visibility)),
    }
}
