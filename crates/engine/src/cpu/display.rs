//! Linear radiance to display values, forward and backward.

use crate::cpu::surface::SurfaceShader;
use crate::display::{srgb, srgb_derivative};

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
