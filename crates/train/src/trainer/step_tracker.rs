//! Tracks pending steps and known results.

use std::collections::VecDeque;

/// A step that the engine was given.
pub(super) struct PendingStep {
    pub(super) step: u32,
    /// Phase to which its PSNR belongs.
    pub(super) phase: u32,
}

/// Metrics of a step.
#[derive(Clone, Copy)]
pub(super) struct StepMetrics {
    /// Completed steps including this one.
    pub(super) step: u32,
    pub(super) loss: f32,
    /// dB.
    pub(super) psnr: f32,
}

/// Pending steps and known results.
#[derive(Default)]
pub(super) struct StepTracker {
    /// Steps whose results are not known, oldest first.
    pub(super) pending: VecDeque<PendingStep>,
    /// The last step whose result is known.
    pub(super) latest: Option<StepMetrics>,
    /// Warning for the next report, about a roll-back between steps.
    pub(super) warning: Option<String>,
    /// A non-finite step; the state since then is invalid.
    pub(super) non_finite_step: Option<u32>,
}

impl StepTracker {
    /// Clears the pending steps; returns the non-finite step.
    pub(super) fn roll_back(&mut self) -> Option<u32> {
        self.pending.clear();
        self.latest = None;
        self.non_finite_step.take()
    }
}
