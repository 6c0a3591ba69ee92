//! Options about photographs that come without poses.

use std::time::Duration;

use clap::ValueEnum;

use crate::cli::serve::storage;
use crate::server::ServerConfig;

/// Whether poses are looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum PoseSearch {
    /// Where COLMAP is installed.
    Auto,
    /// Never: captures must have poses.
    Off,
}

/// Options about photographs that come without poses.
#[derive(Debug, clap::Args)]
pub(super) struct ServePosesArgs {
    /// Whether captures may be photographs without poses: `auto` where COLMAP is on PATH, which finds them, one capture at a time.
    #[arg(long, env = "RELUME_POSES", value_enum, default_value = "auto")]
    poses: PoseSearch,
    /// Minutes that COLMAP may work on one capture.
    #[arg(long, env = "RELUME_POSES_TIMEOUT", value_name = "MINUTES", value_parser = clap::value_parser!(u64).range(1..=100_000), default_value = "240")]
    poses_timeout: u64,
    /// Threads of COLMAP, which make way for trainings and frames; as many as there are processors where absent.
    #[arg(long, env = "RELUME_POSES_THREADS", value_name = "THREADS", value_parser = clap::value_parser!(u32).range(1..=1024))]
    poses_threads: Option<u32>,
    /// Memory that COLMAP may take: bytes, or a number with MiB, GiB or TiB. Half of the machine's or the container's where absent.
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
