//! The policy for photographs without poses.

use std::path::PathBuf;
use std::time::Duration;

use crate::server::memory::default_budget;
use relume_capture::poses::PoseOptions;

/// Whether and how the server finds poses.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PosesPolicy {
    /// Whether poses are found if COLMAP is installed.
    pub is_on: bool,
    /// The program COLMAP: a name on PATH, or a path.
    pub program: PathBuf,
    /// Time limit of COLMAP for one capture, all stages together. It restarts with the server.
    pub timeout: Duration,
    /// Threads of COLMAP; `None` for the number of processors.
    pub threads: Option<u32>,
    /// Memory limit of COLMAP, bytes; `None` for half of the memory of the machine or container.
    pub memory: Option<u64>,
}

impl Default for PosesPolicy {
    /// Pose estimation is off.
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
    /// The options of COLMAP. It runs with lower priority than trainings and frames.
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
