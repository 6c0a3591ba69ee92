//! What is known of what steps came to.

use std::collections::VecDeque;

/// A step that the engine was asked for.
pub(super) struct PendingStep {
    pub(super) step: u32,
    /// Which of the records its PSNR belongs to.
    pub(super) phase: u32,
}

/// What a step came to.
#[derive(Clone, Copy)]
pub(super) struct StepMetrics {
    /// Steps done with it.
    pub(super) step: u32,
    pub(super) loss: f32,
    /// dB.
    pub(super) psnr: f32,
}

/// What is known of the steps so far.
#[derive(Default)]
pub(super) struct StepTracker {
    /// Steps whose sums are not known, oldest first.
    pub(super) pending: VecDeque<PendingStep>,
    /// The last step whose sums are known.
    pub(super) latest: Option<StepMetrics>,
    /// What the next report is to say of a step that was rolled back unasked.
    pub(super) warning: Option<String>,
    /// A step that was not finite: what was done since must not be built on.
    pub(super) non_finite_step: Option<u32>,
}

impl StepTracker {
    /// Forgets the steps that are rolled back; gives the one that was not finite.
    pub(super) fn roll_back(&mut self) -> Option<u32> {
        self.pending.clear();
        self.latest = None;
        self.non_finite_step.take()
    }
}
