//! Weights of the objective's terms and step sizes of each group of parameters.

use serde::{Deserialize, Serialize};

/// Weights of the objective's terms (docs/MODEL.md section 5).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct LossWeights {
    /// Mean absolute error of the physically based branch.
    pub l1: f32,
    /// D-SSIM of both branches.
    pub ssim: f32,
    /// Radiance branch beside the physically based one; four times as much in captures without masks.
    pub radiance: f32,
    /// Coverage against the masks.
    pub coverage: f32,
    /// Depth-normal consistency.
    pub depth_normal: f32,
    /// Edge-aware smoothness (Eq. 32) of metalness and normals.
    pub smoothness: f32,
    /// Edge-aware smoothness (Eq. 32) of roughness, which at the weight of the others would stay at its first value.
    pub smooth_roughness: f32,
    /// Light neutrality (Eq. 31); 0 by default.
    pub light: f32,
    /// Exposure: the level of the light, by the luminance of a white surface facing up (docs/MODEL.md section 5); a hundredth of this
    /// where the light turns between photographs.
    pub exposure: f32,
    /// Colour of the light: holds it where it is known, and at the estimate over the first three tenths of the steps that
    /// train materials.
    #[serde(alias = "daylight")]
    pub light_colour: f32,
    /// Aggregation (Eq. 24).
    pub aggregation: f32,
    /// Residual (Eq. 25).
    pub residual: f32,
    /// Visibility labels (Eq. 15).
    pub visibility: f32,
    /// Flatness, the mean smallest standard deviation: flat Gaussians have meaningful normals.
    pub flatness: f32,
}

impl LossWeights {
    /// Weights of smoothness by attribute: metalness, roughness, normal.
    pub fn smooth(&self) -> [f32; 3] {
        [self.smoothness, self.smooth_roughness, self.smoothness]
    }
}

impl Default for LossWeights {
    fn default() -> Self {
        Self {
            l1: 1.0,
            ssim: 0.25,
            radiance: 0.5,
            coverage: 0.5,
            depth_normal: 0.2,
            smoothness: 0.05,
            smooth_roughness: 0.015,
            light: 0.0,
            exposure: 0.01,
            light_colour: 0.01,
            aggregation: 0.001,
            residual: 0.01,
            visibility: 0.1,
            flatness: 5.0,
        }
    }
}

/// Adam step sizes, per parameter group, in the normalised world.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct LearningRates {
    /// Centres at the start; decays exponentially to `mean_final`.
    pub mean: f32,
    /// Centres at the end.
    pub mean_final: f32,
    /// ln scales.
    pub scale: f32,
    /// Quaternions.
    pub rotation: f32,
    /// Opacity logits.
    pub opacity: f32,
    /// Normal offsets.
    pub normal: f32,
    /// Metalness and roughness logits.
    pub material: f32,
    /// Sheen, which trains over the last three tenths of the steps.
    pub sheen: f32,
    /// Prototype scores.
    pub scores: f32,
    /// Prototypes.
    pub prototypes: f32,
    /// Albedo residuals.
    pub residual: f32,
    /// Visibility and indirect coefficients.
    pub visibility: f32,
    /// Radiance colour; higher degrees take a twentieth.
    pub radiance: f32,
    /// Environment texels: large, since a sun is a hundred times brighter than the grey it starts from.
    pub environment: f32,
}

impl Default for LearningRates {
    fn default() -> Self {
        Self {
            mean: 2e-3,
            mean_final: 1e-5,
            scale: 2e-2,
            rotation: 1e-2,
            opacity: 0.05,
            normal: 1e-3,
            material: 1e-2,
            sheen: 3e-2,
            scores: 2e-2,
            prototypes: 2e-3,
            residual: 2e-3,
            visibility: 2e-3,
            radiance: 1e-2,
            environment: 0.15,
        }
    }
}
