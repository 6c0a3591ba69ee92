//! Evidence from photographs: the visible contribution of each Gaussian, and how well a state explains the
//! photographs.

use crate::complexity::evidence;
use crate::context::StepContext;
use crate::dataset::Dataset;
use crate::exposure;
use relume_engine::{Photo, PhotoSize, TrainState, evaluation};
use relume_spec::training::{ComplexitySetting, TrainConfig};

/// Number of photographs for blending weights if an approximate value is sufficient.
pub const FEW_VIEWS: usize = 12;
/// Number of photographs for blending weights if single Gaussians are assessed.
pub const MANY_VIEWS: usize = 64;
/// Number of photographs on which ablations are tested.
pub const ABLATION_PHOTOS: usize = 8;
/// Longest side of the photographs that are compared, pixels.
pub const MAX_SIDE: u32 = 400;

/// Inputs of a decision besides the state of the training.
#[derive(Debug, Clone, Copy)]
pub struct DecisionContext<'a> {
    /// Configuration, operators and background.
    pub step: &'a StepContext<'a>,
    /// Completed steps.
    pub steps: u32,
    /// The training photographs.
    pub photos: &'a Dataset,
}

impl<'a> DecisionContext<'a> {
    /// The configuration.
    pub fn config(&self) -> &'a TrainConfig {
        self.step.config
    }

    /// Whether the caller has set the value that would be decided.
    pub fn is_forced(&self, setting: ComplexitySetting) -> bool {
        self.step.config.forced.contains(&setting)
    }

    /// Mean blending weight of each Gaussian per photograph, pixels, over at most `most` photographs.
    pub fn blending_weights(&self, state: &TrainState, most: usize) -> Vec<f32> {
        let mut sums = vec![0.0f32; state.model.gaussians.len()];
        for i in self.evenly_spaced(most) {
            let camera = exposure::reduced_camera(self.photos.camera(i, PhotoSize::Full), MAX_SIDE);
            sums.iter_mut().zip(evaluation::blending_weights(state, &camera)).for_each(|(sum, w)| *sum += w);
        }
        let count = self.photos.len().min(most).max(1) as f32;
        sums.iter_mut().for_each(|sum| *sum /= count);
        sums
    }

    /// PSNR of the physically based branch on some of the photographs, dB.
    pub fn physical_psnr(&self, state: &TrainState) -> f32 {
        self.psnr(|photo| self.step.physical_error(state, photo))
    }

    /// PSNR of the radiance branch on some of the photographs, dB.
    pub fn radiance_psnr(&self, state: &TrainState) -> f32 {
        self.psnr(|photo| self.step.radiance_error(state, photo))
    }

    /// PSNR from the mean squared error that `error` returns for one photograph, dB.
    fn psnr(&self, error: impl Fn(&Photo) -> f32) -> f32 {
        let decoded =
            self.evenly_spaced(ABLATION_PHOTOS).map(|i| self.photos.decode_uncached(i, PhotoSize::Full));
        let errors = decoded.map(|photo| (error(&exposure::reduced(&photo, MAX_SIDE)), 1.0));
        -10.0 * evidence::weighted_mean(errors).max(1e-10).log10()
    }

    /// Mean share of the silhouettes' convex hulls that the silhouettes leave empty; `None` without masks.
    pub fn concavity(&self) -> Option<f32> {
        if !self.step.has_alpha {
            return None;
        }
        let each = self.evenly_spaced(MANY_VIEWS).map(|i| self.photos.decode_uncached(i, PhotoSize::Full));
        let all: Vec<f32> =
            each.filter_map(|p| evidence::concavity(&p.alpha, p.camera.width as usize)).collect();
        (!all.is_empty()).then(|| all.iter().sum::<f32>() / all.len() as f32)
    }

    /// Evenly spaced indices of at most `most` photographs.
    fn evenly_spaced(&self, most: usize) -> impl Iterator<Item = usize> + use<> {
        let (all, count) = (self.photos.len(), self.photos.len().min(most));
        (0..count).map(move |i| i * all / count.max(1))
    }
}
