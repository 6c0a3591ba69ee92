//! What is shaded, a pixel's surface or a Gaussian's, and what shades it.

use relume_scene::light::LightTables;
use relume_scene::{DiffuseForm, MAX_LIGHTS, ShadingOptions, VisibilityForm};

/// Most visibility coefficients (order 6, padded).
pub const MAX_COEFFICIENTS: usize = 64;

/// A surface: a Gaussian's attributes, or those blended in a pixel, divided by coverage.
#[derive(Debug, Clone, Copy)]
pub struct Surface {
    /// Normal, any length.
    pub normal: [f32; 3],
    /// Linear base colour.
    pub albedo: [f32; 3],
    /// Metalness.
    pub metal: f32,
    /// Roughness.
    pub rough: f32,
    /// Natural logarithm of the diffuse term's gain at grazing view; 0 for none.
    pub sheen: f32,
    /// Irradiance gathered from other surfaces.
    pub gathered: [f32; 3],
    /// Radiance from where the environment is blocked.
    pub blocked: [f32; 3],
    /// Share of each of the tables' lights that arrives; 0 where lights are not shaded.
    pub arriving: [f32; MAX_LIGHTS],
    /// Visibility coefficients, zero-padded.
    pub visibility: [f32; MAX_COEFFICIENTS],
    /// Unit direction from the surface to the camera.
    pub view: [f32; 3],
}

/// Gradient of [`Surface`].
#[derive(Debug, Clone, Copy)]
pub struct SurfaceGradient {
    /// By normal.
    pub normal: [f32; 3],
    /// By base colour.
    pub albedo: [f32; 3],
    /// By metalness.
    pub metal: f32,
    /// By roughness.
    pub rough: f32,
    /// By sheen.
    pub sheen: f32,
    /// By the radiance from where the environment is blocked.
    pub blocked: [f32; 3],
    /// By gathered irradiance.
    pub gathered: [f32; 3],
    /// By visibility coefficients.
    pub visibility: [f32; MAX_COEFFICIENTS],
    /// By the direction to the camera.
    pub view: [f32; 3],
}

impl SurfaceGradient {
    pub(super) const fn zero() -> Self {
        Self {
            normal: [0.0; 3],
            albedo: [0.0; 3],
            metal: 0.0,
            rough: 0.0,
            sheen: 0.0,
            blocked: [0.0; 3],
            gathered: [0.0; 3],
            visibility: [0.0; MAX_COEFFICIENTS],
            view: [0.0; 3],
        }
    }
}

/// Shading under one light.
#[derive(Debug, Clone, Copy)]
pub struct SurfaceShader<'a> {
    /// Tables of the light.
    pub tables: &'a LightTables,
    /// The forward model.
    pub options: &'a ShadingOptions,
    /// Degree of the visibility field.
    pub sh_degree: usize,
}

pub(super) fn dot3(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl SurfaceShader<'_> {
    /// From a linear visibility field to a visibility (article Eq. 13).
    pub(super) fn squash(&self, x: f32) -> f32 {
        match self.options.visibility {
            VisibilityForm::Sigmoid => 1.0 / (1.0 + (-x).exp()),
            VisibilityForm::Linear => x.clamp(0.0, 1.0),
            VisibilityForm::Off => 1.0,
        }
    }

    /// Derivative of [`Self::squash`] at `x`, where it gave `y`.
    pub(super) fn squash_derivative(&self, x: f32, y: f32) -> f32 {
        match self.options.visibility {
            VisibilityForm::Sigmoid => y * (1.0 - y),
            VisibilityForm::Linear => f32::from(x > 0.0 && x < 1.0),
            VisibilityForm::Off => 0.0,
        }
    }

    pub(super) fn is_open(&self) -> bool {
        self.options.visibility == VisibilityForm::Off
    }

    /// Whether one number stands for the visibility of all directions.
    pub(super) fn is_scalar(&self) -> bool {
        self.is_open() || self.options.diffuse == DiffuseForm::AmbientOcclusion
    }
}
