//! Weights of the objective (docs/MODEL.md, section 5) for both engines; 0 disables a term.

use relume_scene::light::LightColour;

/// Weights of one branch's image term (Eq. 30).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ImageWeights {
    /// Mean absolute error.
    pub l1: f32,
    /// `1 - SSIM`.
    pub ssim: f32,
}

/// Weights of the terms on the G-buffer.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SurfaceWeights {
    /// Coverage against the mask; zero for captures without masks.
    pub coverage: f32,
    /// Depth-normal consistency; only for passes with normals.
    pub depth_normal: f32,
    /// Smoothness (Eq. 32) of metalness, roughness and normal; only for passes with material.
    pub smoothness: [f32; 3],
}

/// Weights of the terms on the light.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LightWeights {
    /// Light neutrality (Eq. 31).
    pub neutrality: f32,
    /// Exposure: the luminance of a white surface facing up.
    pub exposure: f32,
    /// Colour of the irradiance of a surface facing up.
    pub colour: f32,
    /// Target of the colour term.
    pub wanted: LightColour,
    /// Distance from the target below which the colour term is 0, for each of its two logarithms.
    pub tolerance: f32,
}

/// Weights of the terms on the parameters.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ParameterWeights {
    /// Aggregation (Eq. 24).
    pub aggregation: f32,
    /// Residual (Eq. 25).
    pub residual: f32,
    /// Mean smallest standard deviation.
    pub flatness: f32,
    /// Visibility against probe labels.
    pub probe_labels: f32,
    /// Visibility against backward transmittance (Eq. 15).
    pub view_labels: f32,
}

/// Weights of all terms.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StepWeights {
    /// Image term of the physically based branch.
    pub physical: ImageWeights,
    /// Image term of the radiance branch.
    pub radiance: ImageWeights,
    /// Terms on the G-buffer.
    pub surface: SurfaceWeights,
    /// Terms on the light.
    pub light: LightWeights,
    /// Terms on the parameters.
    pub parameters: ParameterWeights,
}

impl LightWeights {
    /// Returns by how much `distance` exceeds the tolerance, with the sign of `distance`; 0 within the tolerance.
    pub fn beyond_tolerance(&self, distance: f32) -> f32 {
        distance - distance.clamp(-self.tolerance, self.tolerance)
    }
}

/// Contribution of a texel of unit radiance, `(direction, solid angle in sr)`, to the irradiance of a surface facing up (+Z),
/// divided by pi.
pub fn upward_share((direction, solid_angle): &(glam::DVec3, f64)) -> f32 {
    (direction.z.max(0.0) * solid_angle / std::f64::consts::PI) as f32
}
