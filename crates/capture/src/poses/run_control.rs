//! Who follows the work: told how far it is, asked whether it is still wanted.

use std::time::{Duration, Instant};

/// A stage of the work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PoseStage {
    /// Frames of a clip.
    Frames,
    /// Features of each photograph.
    Features,
    /// Features that photographs share.
    Matching,
    /// Placing photographs one after the other.
    Mapping,
}

impl PoseStage {
    /// What it does, in a word or two.
    pub fn name(self) -> &'static str {
        match self {
            Self::Frames => "frames",
            Self::Features => "features",
            Self::Matching => "matches",
            Self::Mapping => "poses",
        }
    }
}

/// How far a stage is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PoseProgress {
    /// The stage.
    pub stage: PoseStage,
    /// Photographs or groups of them that are done.
    pub done: u64,
    /// Of how many.
    pub total: u64,
}

/// Who follows the work.
pub struct RunControl<'a> {
    /// Told of progress.
    pub progress: &'a mut dyn FnMut(PoseProgress),
    /// Asked several times a second; once true, the work ends as [`super::PoseError::Cancelled`].
    pub is_cancelled: &'a dyn Fn() -> bool,
    /// When the work must have ended, and the limit that it comes from.
    deadline: Instant,
    limit: Duration,
}

impl<'a> RunControl<'a> {
    /// A watch over work that may take `limit` from now on.
    pub fn new(
        limit: Duration,
        progress: &'a mut dyn FnMut(PoseProgress),
        is_cancelled: &'a dyn Fn() -> bool,
    ) -> Self {
        let now = Instant::now();
        // A limit beyond what the clock can say is none: a century will do.
        let century = Duration::from_secs(100 * 366 * 24 * 3600);
        let deadline = now.checked_add(limit).unwrap_or_else(|| now + century);
        Self { progress, is_cancelled, deadline, limit }
    }

    /// True once the time is over.
    pub(super) fn is_over(&self) -> bool {
        Instant::now() >= self.deadline
    }

    /// The limit, minutes, rounded up.
    pub(super) fn minutes(&self) -> u64 {
        (self.limit.as_secs_f64() / 60.0).ceil() as u64
    }
}
