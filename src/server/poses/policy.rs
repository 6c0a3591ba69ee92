//! What the operator lets the server do about photographs without poses.

use std::path::PathBuf;
use std::time::Duration;

use crate::server::memory::default_budget;
use relume_capture::poses::PoseOptions;

/// Whether and how poses are found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PosesPolicy {
    /// Whether they are looked for where COLMAP is installed.
    pub is_on: bool,
    /// COLMAP's program: a name to be looked for on PATH, or a path.
    pub program: PathBuf,
    /// How long COLMAP may work on one capture, all stages together. After a restart of the server it begins anew.
    pub timeout: Duration,
    /// Threads of COLMAP; as many as there are processors when absent.
    pub threads: Option<u32>,
    /// Bytes of memory that COLMAP may take; half of the machine's or the container's when absent.
    pub memory: Option<u64>,
}

impl Default for PosesPolicy {
    /// Off.
    fn default() -> Self {
        Self {
            is_on: false,
            program: "colmap".into(),
            timeout: Duration::from_secs(4 * 3600),
            threads: None,
            memory: None,
        }
    }
}

impl PosesPolicy {
    /// What COLMAP is told. It makes way for trainings and frames.
    pub(super) fn options(&self) -> PoseOptions {
        PoseOptions {
            program: self.program.clone(),
            threads: self.threads,
            memory: Some(self.memory.unwrap_or_else(default_budget)),
            low_priority: true,
            ..PoseOptions::default()
        }
    }
}
