//! Density control between host and engine: the host plans from a few floats a Gaussian, the engine rebuilds the model.

/// What a new Gaussian is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SplitOrigin {
    /// Its source, moments included.
    Keep,
    /// Its source's half on the positive side of the longest axis, moments zero.
    UpperHalf,
    /// The other half, moments zero.
    LowerHalf,
}

/// A round of density control: for each Gaussian of the next generation, its source's index and what is made of it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct DensityPlan {
    /// `(source, origin)` in the new order.
    pub entries: Vec<(u32, SplitOrigin)>,
}

/// Running statistics since the last round, by Gaussian.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DensityStats {
    /// Sum of absgrads ([`crate::engine::Gradients::absgrad`]).
    pub absgrad: Vec<f32>,
    /// Steps in which the Gaussian was on screen.
    pub seen: Vec<f32>,
}

impl DensityStats {
    /// Empty statistics for `n` Gaussians.
    pub fn zeroed(n: usize) -> Self {
        Self { absgrad: vec![0.0; n], seen: vec![0.0; n] }
    }
}

/// Whether camera distances are planned with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Positions {
    /// Centres are read.
    Read,
    /// Centres are left out.
    LeftOut,
}

/// What a plan is made from, by Gaussian.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DensitySignals {
    /// Centres, world units; empty unless asked for.
    pub means: Vec<[f32; 3]>,
    /// ln of the standard deviations, world units.
    pub log_scales: Vec<[f32; 3]>,
    /// Opacity logits.
    pub opacity_logits: Vec<f32>,
    /// Statistics since the last round.
    pub stats: DensityStats,
}
