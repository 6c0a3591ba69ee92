//! A surface to shade, in a pixel or at a Gaussian, and its shader.

use relume_scene::light::LightTables;
use relume_scene::{DiffuseForm, DisplayRange, MAX_LIGHTS, ShadingOptions, VisibilityForm};

/// Maximum number of visibility coefficients (degree 6, padded).
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
    /// Natural logarithm of the diffuse term's gain at grazing view; 0 is no sheen.
    pub sheen: f32,
    /// Irradiance gathered from other surfaces.
    pub gathered: [f32; 3],
    /// Radiance from directions in which the environment is blocked.
    pub blocked: [f32; 3],
    /// Arriving share of each dominant light; 0 where dominant lights are not shaded.
    pub arriving: [f32; MAX_LIGHTS],
    /// Visibility coefficients, zero-padded.
    pub visibility: [f32; MAX_COEFFICIENTS],
    /// Unit direction from the surface to the camera.
    pub view: [f32; 3],
}

/// Gradient of [`Surface`].
#[derive(Debug, Clone, Copy)]
pub struct SurfaceGradient {
    /// Gradient by normal.
    pub normal: [f32; 3],
    /// Gradient by base colour.
    pub albedo: [f32; 3],
    /// Gradient by metalness.
    pub metal: f32,
    /// Gradient by roughness.
    pub rough: f32,
    /// Gradient by sheen.
    pub sheen: f32,
    /// Gradient by `blocked`.
    pub blocked: [f32; 3],
    /// Gradient by gathered irradiance.
    pub gathered: [f32; 3],
    /// Gradient by visibility coefficients.
    pub visibility: [f32; MAX_COEFFICIENTS],
    /// Gradient by the direction to the camera.
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

/// Shader under one light.
#[derive(Debug, Clone, Copy)]
pub struct SurfaceShader<'a> {
    /// Tables of the light.
    pub tables: &'a LightTables,
    /// Options of the forward model.
    pub options: &'a ShadingOptions,
    /// Degree of the visibility field.
    pub sh_degree: usize,
    /// Range of the display values of images.
    pub range: DisplayRange,
}

pub(super) fn dot3(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl SurfaceShader<'_> {
    /// Visibility, 0 to 1, from the value of a linear visibility field (article Eq. 13).
    pub(super) fn squash(&self, x: f32) -> f32 {
        match self.options.visibility {
            VisibilityForm::Sigmoid => 1.0 / (1.0 + (-x).exp()),
            VisibilityForm::Linear => x.clamp(0.0, 1.0),
            VisibilityForm::Off => 1.0,
        }
    }

    /// Derivative of [`Self::squash`] at `x`, where it returned `y`.
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

    /// True where one number is the visibility of all directions.
    pub(super) fn is_scalar(&self) -> bool {
        self.is_open() || self.options.diffuse == DiffuseForm::AmbientOcclusion
    }
}
