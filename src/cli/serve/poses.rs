//! Options for photographs without poses.

use std::time::Duration;

use clap::ValueEnum;

use crate::cli::serve::storage;
use crate::server::ServerConfig;

/// Whether the server finds poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum PoseSearch {
    /// If COLMAP is installed.
    Auto,
    /// Never; captures must have poses.
    Off,
}

/// Options for photographs without poses.
#[derive(Debug, clap::Args)]
pub(super) struct ServePosesArgs {
    /// Whether captures may be photographs without poses: `auto` (if COLMAP is on PATH) or `off`. COLMAP finds the poses of one
    /// capture at a time.
    #[arg(long, env = "RELUME_POSES", value_enum, default_value = "auto")]
    poses: PoseSearch,
    /// Time limit of COLMAP for one capture, minutes.
    #[arg(long, env = "RELUME_POSES_TIMEOUT", value_name = "MINUTES", value_parser = clap::value_parser!(u64).range(1..=100_000), default_value = "240")]
    poses_timeout: u64,
    /// Threads of COLMAP, which run with lower priority than trainings and frames. Default: the number of processors.
    #[arg(long, env = "RELUME_POSES_THREADS", value_name = "THREADS", value_parser = clap::value_parser!(u32).range(1..=1024))]
    poses_threads: Option<u32>,
    /// Memory limit of COLMAP: bytes, or a number with MiB, GiB or TiB. Default: half of the memory of the machine or container.
    #[arg(long, env = "RELUME_POSES_MEMORY", value_name = "SIZE", value_parser = storage::size)]
    poses_memory: Option<u64>,
}

impl ServePosesArgs {
    pub(super) fn apply(&self, config: &mut ServerConfig) {
        config.poses.is_on = self.poses == PoseSearch::Auto;
        config.poses.timeout = Duration::from_secs(60 * self.poses_timeout);
        config.poses.threads = self.poses_threads;
        config.poses.memory = self.poses_memory;
    }
}
