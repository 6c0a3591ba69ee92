//! Linear radiance to display values, forward and backward.

use crate::cpu::surface::SurfaceShader;

/// sRGB curve on [0, 1].
#[inline]
pub fn srgb(x: f32) -> f32 {
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

/// Inverse of [`srgb`] on [0, 1].
#[inline]
pub fn linear_from_srgb(x: f32) -> f32 {
    if x <= 0.040_45 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
}

/// Derivative of [`srgb`] at `x`, where `srgb(x) = y`; computed without a second power.
#[inline]
pub fn srgb_derivative(x: f32, y: f32) -> f32 {
    if x <= 0.003_130_8 { 12.92 } else { (y + 0.055) / (2.4 * x) }
}

impl SurfaceShader<'_> {
    /// Linear radiance to display, per channel.
    #[inline]
    pub fn display(&self, linear: f32) -> f32 {
        let clamped = linear.clamp(0.0, 1.0);
        if self.options.srgb { srgb(clamped) } else { clamped }
    }

    /// Chain rule through [`Self::display`] at `linear`, where it returned `shown`. Above 1 only gradients that lower the value
    /// pass (docs/MODEL.md, section 4).
    #[inline]
    pub(super) fn display_backward(&self, linear: f32, shown: f32, g: f32) -> f32 {
        if linear < 0.0 || (linear > 1.0 && g <= 0.0) {
            return 0.0;
        }
        if self.options.srgb { g * srgb_derivative(linear.min(1.0), shown) } else { g }
    }
}
