//! Linear radiance to display values, forward and backward.

use crate::cpu::surface::SurfaceShader;
use crate::display::{srgb, srgb_derivative};

impl SurfaceShader<'_> {
    /// Linear radiance to a display value in the shader's range, per channel.
    #[inline]
    pub fn display(&self, linear: f32) -> f32 {
        let clamped = linear.clamp(0.0, self.range.peak());
        if self.options.srgb { srgb(clamped) } else { clamped }
    }

    /// Chain rule through [`Self::display`] at `linear`, where it returned `shown`. Above the peak only gradients that lower the
    /// value pass (docs/MODEL.md, section 4).
    #[inline]
    pub(super) fn display_backward(&self, linear: f32, shown: f32, g: f32) -> f32 {
        let peak = self.range.peak();
        if linear < 0.0 || (linear > peak && g <= 0.0) {
            return 0.0;
        }
        if self.options.srgb { g * srgb_derivative(linear.min(peak), shown) } else { g }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_scene::light::{EnvOperators, TableResolution};
    use relume_scene::{DisplayRange, ShadingOptions};

    #[test]
    fn extended_range_has_values_and_gradients_above_white() {
        let tables = EnvOperators::new(4, 2, 0, TableResolution::TRAINING).apply(&[[1.0; 3]; 8]);
        let options = ShadingOptions::default();
        let of = |range| SurfaceShader { tables: &tables, options: &options, sh_degree: 0, range };
        let (unit, extended) = (of(DisplayRange::Unit), of(DisplayRange::Extended));
        for linear in [0.0, 0.001, 0.5, 1.0] {
            assert_eq!(unit.display(linear), extended.display(linear));
            let shown = unit.display(linear);
            assert_eq!(
                unit.display_backward(linear, shown, -1.0),
                extended.display_backward(linear, shown, -1.0)
            );
        }
        let shown = extended.display(4.0);
        assert!(shown > 1.8 && unit.display(4.0) <= 1.0, "{shown}");
        let numeric = (extended.display(4.01) - extended.display(3.99)) / 0.02;
        let by = extended.display_backward(4.0, shown, -1.0);
        assert!((by + numeric).abs() < 1e-3 * numeric, "{by} {numeric}");
        assert_eq!(unit.display_backward(4.0, unit.display(4.0), -1.0), 0.0, "the control");
        let white = extended.display(1e6);
        assert!((white - DisplayRange::Extended.white()).abs() < 1e-5, "{white}");
        assert_eq!(extended.display_backward(1e6, white, -1.0), 0.0, "brighter than the peak");
        assert!(extended.display_backward(1e6, white, 1.0) > 0.0);
    }
}
