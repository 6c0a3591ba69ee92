//! Weights of the terms of the objective (docs/MODEL.md section 5), and step sizes of the parameter groups.
//!
//! Equations of the article: smoothness 32, light neutrality 31, aggregation 24, residual 25, visibility
//! labels 15.

use crate::training::group::group;

group! {
    /// Weights of the terms of the objective, 0 to 1000.
    LossWeights changed by LossWeightChanges as LossWeights {
        /// Mean absolute error of the physically based branch.
        l1: f32 = 1.0;
        /// D-SSIM of both branches.
        ssim: f32 = 0.25;
        /// Loss of the radiance branch. Captures without masks use four times this weight.
        radiance: f32 = 0.5;
        /// Error of the coverage relative to the masks.
        coverage: f32 = 0.5;
        /// Depth-normal consistency.
        depth_normal: f32 = 0.2;
        /// Edge-aware smoothness of metalness and normals.
        smoothness: f32 = 0.05;
        /// Edge-aware smoothness of roughness. At the weight `smoothness`, roughness would stay at its
        /// initial value.
        smooth_roughness: f32 = 0.015;
        /// Light neutrality. Default: 0.
        light: f32 = 0.0;
        /// Exposure: the level of the light, measured as the luminance of a white surface that faces up. A
        /// hundredth of this weight applies if the light rotates between photographs.
        exposure: f32 = 0.01;
        /// Colour of the light: keeps a known colour, or keeps the estimate during the first three tenths of
        /// the steps that train materials.
        #[serde(alias = "daylight")]
        light_colour: f32 = 0.01;
        /// Aggregation of albedo prototypes.
        aggregation: f32 = 0.001;
        /// Albedo residual.
        residual: f32 = 0.01;
        /// Error of the visibility relative to its labels.
        visibility: f32 = 0.1;
        /// Flatness: mean of the smallest standard deviation of each Gaussian. Flat Gaussians have meaningful
        /// normals.
        flatness: f32 = 5.0;
    }
}

impl LossWeights {
    /// Smoothness weights of metalness, roughness and normal.
    pub fn smooth(&self) -> [f32; 3] {
        [self.smoothness, self.smooth_roughness, self.smoothness]
    }
}

group! {
    /// Adam step sizes per parameter group, in the normalised world, 0 to 1000.
    LearningRates changed by LearningRateChanges as LearningRates {
        /// Centres at the start. The step size decays exponentially to `mean_final`.
        mean: f32 = 0.002;
        /// Centres at the end.
        mean_final: f32 = 0.00001;
        /// Logarithms of the scales.
        scale: f32 = 0.02;
        /// Quaternions.
        rotation: f32 = 0.01;
        /// Opacity logits.
        opacity: f32 = 0.05;
        /// Normal offsets.
        normal: f32 = 0.001;
        /// Metalness and roughness logits.
        material: f32 = 0.01;
        /// Sheen, trained during the last three tenths of the steps.
        sheen: f32 = 0.03;
        /// Prototype scores.
        scores: f32 = 0.02;
        /// Prototypes.
        prototypes: f32 = 0.002;
        /// Albedo residuals.
        residual: f32 = 0.002;
        /// Visibility and indirect coefficients.
        visibility: f32 = 0.002;
        /// Radiance colour. Higher degrees use a twentieth of this step size.
        radiance: f32 = 0.01;
        /// Environment texels. The default is large because a sun is a hundred times brighter than the
        /// initial grey.
        environment: f32 = 0.15;
    }
}
