//! What a step is asked for, and what it comes to.

use crate::engine::RasterCamera;
use crate::engine::channel::Channels;
use crate::engine::gpu::Buffer;
use crate::engine::gpu::light::LightWeights;
use crate::engine::gpu::losses::{LOSS_SLOTS, LossSlot, SurfaceWeights};
use crate::engine::gpu::update::{Ages, ParameterTerms, Rates};

/// Slot of the sums that carries the status of the update instead.
pub(super) const STATUS_SLOT: usize = LOSS_SLOTS - 1;

/// Weights of one branch's image term (Eq. 30).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ImageWeights {
    /// Mean absolute error.
    pub l1: f32,
    /// `1 - SSIM`.
    pub ssim: f32,
}

/// Weights of all terms of the objective (docs/MODEL.md section 5); 0 is off.
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
    pub parameters: ParameterTerms,
}

/// One optimisation step.
#[derive(Debug, Clone, Copy)]
pub struct Step<'a> {
    /// The camera.
    pub view: RasterCamera,
    /// The photograph, row-major: rgb over the background, mask.
    pub photo: &'a Buffer<[f32; 4]>,
    /// What the photograph was composited over, display-referred.
    pub background: [f32; 3],
    /// Channels of the pass: `Full` for the physically based branch, fewer for the radiance branch alone.
    pub channels: Channels,
    /// Channels the way back carries.
    pub differentiated: Channels,
    /// The objective.
    pub weights: StepWeights,
    /// Adam's step sizes.
    pub rates: Rates,
    /// Adam's ages.
    pub ages: Ages,
}

/// What a step came to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepSums {
    /// The objective.
    pub loss: f32,
    /// Mean squared error of the leading branch.
    pub mse: f32,
    /// False when a gradient or the objective was not finite: the state must not be built on.
    pub finite: bool,
}

/// The objective from its sums: the image slots hold means without weight, the others carry theirs.
pub(super) fn objective(sums: &[f32], weights: &StepWeights) -> f32 {
    let at = |slot: LossSlot| sums[slot as usize];
    let image = |w: &ImageWeights, l1: LossSlot, ssim: LossSlot| w.l1 * at(l1) + w.ssim * (1.0 - at(ssim));
    let rest: f32 = sums[LossSlot::Coverage as usize..STATUS_SLOT].iter().sum();
    rest + image(&weights.physical, LossSlot::PhysicalL1, LossSlot::PhysicalSsim)
        + image(&weights.radiance, LossSlot::RadianceL1, LossSlot::RadianceSsim)
}
