//! Wider Gaussians for programs that have no sampling rates.

use relume_layout::constants::ENLARGED_LOW_PASS;
use relume_scene::{Field, Model};

use crate::formats::splats::Splats;

/// Limits of an opacity before the sigmoid: its inverse is finite.
const MAX_LOGIT: f64 = 60.0;

impl Splats {
    /// Copies that other programs can show larger than the photographs: the two longer axes are widened by the low-pass that Relume
    /// draws enlarged Gaussians with ([`ENLARGED_LOW_PASS`] of the one of the photograph that shows the Gaussian largest), and the
    /// opacity falls by the growth of their area. The shortest axis stays, so that silhouettes stay sharp. Gaussians without a sampling
    /// rate stay.
    ///
    /// `self` was made from `model`.
    #[must_use]
    pub fn with_low_pass(mut self, model: &Model) -> Self {
        let rates = model.gaussians.field(Field::SamplingRate);
        for (i, rate) in rates.iter().enumerate().filter(|(_, rate)| **rate > 0.0) {
            let per_capture_unit = f64::from(*rate) * model.world_scale;
            let variance = f64::from(ENLARGED_LOW_PASS * model.shading.low_pass) / per_capture_unit.powi(2);
            let mut area = 1.0;
            for axis in two_longer_axes(self.log_scales[i]) {
                let before = f64::from(self.scale(i)[axis]);
                let after = before.hypot(variance.sqrt());
                area *= before / after;
                self.log_scales[i][axis] = after.ln() as f32;
            }
            self.opacity_logits[i] = scaled_opacity(self.opacity_logits[i], area);
        }
        self
    }
}

/// The axes other than the shortest one.
fn two_longer_axes(log_scales: [f32; 3]) -> [usize; 2] {
    let mut axes = [0, 1, 2];
    axes.sort_by(|a, b| log_scales[*a].total_cmp(&log_scales[*b]));
    [axes[1], axes[2]]
}

/// The logit of `factor` times the opacity with logit `logit`.
fn scaled_opacity(logit: f32, factor: f64) -> f32 {
    let opacity = factor / (1.0 + (-f64::from(logit)).exp());
    (opacity.ln() - (1.0 - opacity).ln()).clamp(-MAX_LOGIT, MAX_LOGIT) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::splats::tests::example;

    /// The example with sampling rates of 8 and 0 pixels per model unit; one capture unit is two model units.
    fn sampled() -> Model {
        let mut model = example();
        model.gaussians.row_mut(Field::LogScale, 0).copy_from_slice(&[
            0.01f32.ln(),
            0.02f32.ln(),
            1e-4f32.ln(),
        ]);
        model.gaussians.row_mut(Field::OpacityLogit, 0)[0] = 3.0;
        model.gaussians.row_mut(Field::SamplingRate, 0)[0] = 8.0;
        model
    }

    #[test]
    fn longer_axes_widen_by_the_low_pass_of_the_photograph() {
        let model = sampled();
        let before = Splats::of(&model);
        let after = before.clone().with_low_pass(&model);
        let variance = ENLARGED_LOW_PASS * model.shading.low_pass / (8.0f32 * 2.0).powi(2);
        let (was, is) = (before.scale(0), after.scale(0));
        for axis in [0, 1] {
            let expected = (was[axis].powi(2) + variance).sqrt();
            assert!((is[axis] / expected - 1.0).abs() < 1e-5, "{is:?}");
        }
        assert!((is[2] / was[2] - 1.0).abs() < 1e-6, "the shortest axis: {is:?}");
        let mass = |s: &Splats| s.opacity(0) * s.scale(0)[0] * s.scale(0)[1];
        assert!((mass(&after) / mass(&before) - 1.0).abs() < 1e-4, "{} {}", mass(&after), mass(&before));
        assert!(after.opacity(0) < 0.5 * before.opacity(0), "the control: the opacity falls");
    }

    #[test]
    fn gaussians_without_a_sampling_rate_keep_their_shape() {
        let model = sampled();
        let (before, after) = (Splats::of(&model), Splats::of(&model).with_low_pass(&model));
        assert_eq!(
            (before.log_scales[1], before.opacity_logits[1]),
            (after.log_scales[1], after.opacity_logits[1])
        );
        assert_ne!(before.log_scales[0], after.log_scales[0], "the control");
    }

    #[test]
    fn extreme_opacities_and_sizes_stay_finite() {
        let mut model = sampled();
        for (logit, size, rate) in
            [(f32::INFINITY, -80.0, 1e-30), (f32::NEG_INFINITY, 80.0, 1e30), (60.0, 0.0, 1e30)]
        {
            model.gaussians.row_mut(Field::OpacityLogit, 0)[0] = logit;
            model.gaussians.row_mut(Field::LogScale, 0).fill(size);
            model.gaussians.row_mut(Field::SamplingRate, 0)[0] = rate;
            let splats = Splats::of(&model).with_low_pass(&model);
            let values = splats.log_scales[0].iter().chain([&splats.opacity_logits[0]]);
            assert!(values.clone().all(|v| v.is_finite()), "{:?}", values.collect::<Vec<_>>());
        }
    }
}
