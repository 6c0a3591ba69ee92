//! What is known of what steps came to.

use std::collections::VecDeque;

/// A step that the engine was asked for.
pub(super) struct Asked {
    pub(super) step: u32,
    /// Which of the records its PSNR belongs to.
    pub(super) phase: u32,
}

/// What a step came to.
#[derive(Clone, Copy)]
pub(super) struct Known {
    /// Steps done with it.
    pub(super) step: u32,
    pub(super) loss: f32,
    /// dB.
    pub(super) psnr: f32,
}

/// What is known of the steps so far.
#[derive(Default)]
pub(super) struct KnownSums {
    /// Steps whose sums are not known, oldest first.
    pub(super) asked: VecDeque<Asked>,
    /// The last step whose sums are known.
    pub(super) latest: Option<Known>,
    /// What the next report is to say of a step that was rolled back unasked.
    pub(super) warning: Option<String>,
    /// A step that was not finite: what was done since must not be built on.
    pub(super) unsound: Option<u32>,
}

impl KnownSums {
    /// Forgets the steps that are rolled back; gives the one that was not finite.
    pub(super) fn roll_back(&mut self) -> Option<u32> {
        self.asked.clear();
        self.latest = None;
        self.unsound.take()
    }
}
