//! Progress reports, cancellation and the time limit of pose estimation.

use std::time::{Duration, Instant};

/// A stage of pose estimation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PoseStage {
    /// Frames are extracted from a clip.
    Frames,
    /// Features are extracted from each photograph.
    Features,
    /// Features are matched between photographs.
    Matching,
    /// Photographs are registered one after the other.
    Mapping,
}

impl PoseStage {
    /// A short name of the stage.
    pub fn name(self) -> &'static str {
        match self {
            Self::Frames => "frames",
            Self::Features => "features",
            Self::Matching => "matches",
            Self::Mapping => "poses",
        }
    }
}

/// Progress of a stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PoseProgress {
    /// The stage.
    pub stage: PoseStage,
    /// Photographs, or groups of them, that are done.
    pub done: u64,
    /// Total number of photographs or groups.
    pub total: u64,
}

/// Progress callback, cancellation and time limit.
pub struct RunControl<'a> {
    /// Called with the progress.
    pub progress: &'a mut dyn FnMut(PoseProgress),
    /// Called several times a second. If it returns true, the work ends with [`super::PoseError::Cancelled`].
    pub is_cancelled: &'a dyn Fn() -> bool,
    /// The time by which the work must end, and the limit from which it follows.
    deadline: Instant,
    limit: Duration,
}

impl<'a> RunControl<'a> {
    /// Control of work that may take `limit` from now on.
    pub fn new(
        limit: Duration,
        progress: &'a mut dyn FnMut(PoseProgress),
        is_cancelled: &'a dyn Fn() -> bool,
    ) -> Self {
        let now = Instant::now();
        // If the deadline is beyond the range of the clock, a century replaces the limit.
        let century = Duration::from_secs(100 * 366 * 24 * 3600);
        let deadline = now.checked_add(limit).unwrap_or_else(|| now + century);
        Self { progress, is_cancelled, deadline, limit }
    }

    /// True once the deadline has passed.
    pub(super) fn is_over(&self) -> bool {
        Instant::now() >= self.deadline
    }

    /// The time limit in minutes, rounded up.
    pub(super) fn minutes(&self) -> u64 {
        (self.limit.as_secs_f64() / 60.0).ceil() as u64
    }
}
