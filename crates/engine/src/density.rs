//! Data of density control: the signals from which the host plans a round, and the plan that an engine executes.

use crate::Gradients;

/// Statistics of each Gaussian since the last round.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DensityStats {
    /// Sum of the AbsGS signal: magnitudes of the gradient by the projected mean, pixel by pixel (half image widths).
    pub absgrad: Vec<f32>,
    /// Number of steps in which the Gaussian was on screen.
    pub seen: Vec<f32>,
}

impl DensityStats {
    /// Empty statistics for `n` Gaussians.
    pub fn zeroed(n: usize) -> Self {
        Self { absgrad: vec![0.0; n], seen: vec![0.0; n] }
    }

    /// Adds a step's gradients.
    pub fn record(&mut self, g: &Gradients) {
        for (i, visible) in g.visible.iter().enumerate() {
            if *visible {
                self.absgrad[i] += g.absgrad[i];
                self.seen[i] += 1.0;
            }
        }
    }
}

/// The signals from which a round is planned, per Gaussian.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DensitySignals {
    /// Centres, normalised world.
    pub means: Vec<[f32; 3]>,
    /// ln of the standard deviations.
    pub log_scales: Vec<[f32; 3]>,
    /// Opacity logits.
    pub opacity_logits: Vec<f32>,
    /// Statistics since the last round.
    pub stats: DensityStats,
}

/// Derivation of a Gaussian of the next generation from its source.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SplitOrigin {
    /// The source itself, with its moments.
    Keep,
    /// The half on the positive side of the source's longest axis, moments zero.
    UpperHalf,
    /// The other half, moments zero.
    LowerHalf,
}

/// A Gaussian of the next generation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PlannedGaussian {
    /// Index of its source in the old generation.
    pub source: u32,
    /// Its derivation from the source.
    pub origin: SplitOrigin,
}

/// A round of density control: the Gaussians of the next generation, in order.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct DensityPlan {
    /// The next generation.
    pub gaussians: Vec<PlannedGaussian>,
}
