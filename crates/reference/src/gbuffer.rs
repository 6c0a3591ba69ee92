//! The G-buffer: per-Gaussian attributes blended into screen space (docs/MODEL.md, section 3).

use super::compositing::Weights;
use super::model::Parameters;
use super::projection::Splats;
use super::tape::Var;
use relume_scene::Field;

/// Light of N Gaussians or P pixels.
#[derive(Clone, Copy)]
pub enum BlendedLight<'t> {
    /// Light of Gaussians that are shaded before blending.
    Outgoing {
        /// Radiance towards the camera, (N, 3).
        total: Var<'t>,
        /// Its specular part, (N, 3).
        specular: Var<'t>,
    },
    /// Light of attributes that are shaded in the pixel.
    Incident {
        /// Irradiance gathered from other Gaussians, (N, 3).
        gathered: Var<'t>,
        /// Radiance from directions in which the environment is blocked, (N, 3).
        blocked: Var<'t>,
    },
}

/// Attributes of N Gaussians, except their material parameters.
pub struct Attributes<'t> {
    /// Unit normal, (N, 3).
    pub normal: Var<'t>,
    /// Signed distance of the splat's plane from the camera, (N, 1).
    pub plane: Var<'t>,
    /// Colour of the radiance branch, display-referred, (N, 3).
    pub radiance: Var<'t>,
    /// Light.
    pub light: BlendedLight<'t>,
}

/// Attributes of P pixels, divided by coverage unless stated otherwise.
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
    /// Light, divided by coverage.
    pub light: BlendedLight<'t>,
    /// Visibility SH coefficients, (P, (L + 1)^2).
    pub visibility: Var<'t>,
}

/// Smallest coverage by which attributes are divided.
const MIN_COVERAGE: f64 = 1e-6;

/// Blends the attributes of the splats' Gaussians.
pub fn blend<'t>(
    p: &Parameters<'t>,
    splats: &Splats<'t>,
    weights: &Weights<'t>,
    attributes: &Attributes<'t>,
) -> GBuffer<'t> {
    let sums = |of: Var<'t>| weights.weights.matmul(of.gather(0, &splats.indices));
    let coverage = weights.alpha;
    let divisor = coverage.at_least(MIN_COVERAGE);
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
        light: match attributes.light {
            BlendedLight::Outgoing { total, specular } => {
                BlendedLight::Outgoing { total: mean(total), specular: mean(specular) }
            }
            BlendedLight::Incident { gathered, blocked } => {
                BlendedLight::Incident { gathered: mean(gathered), blocked: mean(blocked) }
            }
        },
        visibility: mean(p.get(Field::Visibility)),
    }
}
