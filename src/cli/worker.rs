//! `relume worker`: claims jobs of a server and trains them on this machine.

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

use sysinfo::System;
use tokio_util::sync::CancellationToken;

use crate::cli::error::{CommandResult, STOPPED};
use crate::cli::key::key;
use crate::cli::progress::ProgressKind;
use crate::cli::size::size;
use crate::cli::stop::{StopRequest, on_stop};
use crate::cli::worker_progress::progress_observer;
use crate::jobs::{Ids, RandomIds, SystemClock};
use crate::remote_worker::{FileCache, RemoteJobs};
use crate::worker::{self, JobOutcome, OpenedDevice, TrainingOptions};
use relume_api::work::{WorkerHello, validate_labels};
use relume_client::Client;
use relume_engine::DeviceChoice;

/// Exit code of `--once` if the job failed.
const JOB_FAILED: u8 = 3;

/// Options of `relume worker`.
#[derive(Debug, clap::Args)]
pub(super) struct WorkerArgs {
    /// The server whose jobs to train, e.g. `https://relume.example.org`.
    #[arg(long, env = "RELUME_SERVER")]
    server: String,
    /// A file with an API key with the scope `work`. Alternatively set the variable RELUME_API_KEY.
    #[arg(long, value_name = "FILE")]
    key_file: Option<PathBuf>,
    /// Train at most one job, then exit. Exit immediately if no job is queued.
    #[arg(long)]
    once: bool,
    /// Device for training: `auto`, `cpu`, `gpu` or `gpu:N`; `relume doctor` lists the devices.
    #[arg(long, env = "RELUME_DEVICE", default_value_t)]
    device: DeviceChoice,
    /// Labels of this worker, separated by commas. A job can require labels of its worker.
    #[arg(long, env = "RELUME_WORKER_LABELS", value_delimiter = ',')]
    labels: Vec<String>,
    /// A descriptive name of this worker. Default: the host name.
    #[arg(long, env = "RELUME_WORKER_NAME")]
    name: Option<String>,
    /// Format of progress reports.
    #[arg(long, value_enum, default_value = "human")]
    progress: ProgressKind,
    /// The folder for cached downloads. Several workers of one machine may share it.
    #[arg(long, env = "RELUME_CACHE", default_value = "relume-cache")]
    cache: PathBuf,
    /// Maximum size of the cache: bytes, or a number with MiB, GiB or TiB.
    #[arg(long, env = "RELUME_CACHE_BYTES", value_name = "SIZE", value_parser = size, default_value = "64GiB")]
    cache_bytes: u64,
}

pub(super) fn run(args: WorkerArgs) -> CommandResult<ExitCode> {
    tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?.block_on(work(args))
}

async fn work(args: WorkerArgs) -> CommandResult<ExitCode> {
    if let Some(why) = validate_labels(&args.labels) {
        return Err(format!("--labels: {why}").into());
    }
    let client = Client::new(&args.server, key(args.key_file.as_deref())?)
        .map_err(|error| format!("--server: {error}"))?;
    let cache = FileCache::open(&args.cache, args.cache_bytes)
        .map_err(|error| format!("--cache {}: {error}", args.cache.display()))?;
    let device = OpenedDevice::open(args.device)?;
    let hello = WorkerHello {
        id: RandomIds.fresh().into(),
        name: args.name.or_else(System::host_name).unwrap_or_else(|| "worker".to_owned()),
        device: device.device().name(),
        has_gpu: device.device().is_gpu(),
        labels: args.labels,
        version: env!("CARGO_PKG_VERSION").to_owned(),
    };
    let source =
        RemoteJobs::new(client, hello, cache, Arc::new(SystemClock), progress_observer(args.progress));
    let stop = CancellationToken::new();
    stop_on_signals(stop.clone())?;
    let options = TrainingOptions { once: args.once, ..TrainingOptions::default() };
    let thread = worker::start_training(Arc::new(source), device, options, stop)?;
    let ended = tokio::task::spawn_blocking(move || thread.join()).await?;
    match ended.map_err(|_| "the training thread panicked")? {
        Some(JobOutcome::Refused) => {
            Err("the server refused this worker; the log contains the reason".into())
        }
        Some(JobOutcome::Requeued) => Ok(ExitCode::from(STOPPED)),
        Some(JobOutcome::Failed) if args.once => Ok(ExitCode::from(JOB_FAILED)),
        _ => Ok(ExitCode::SUCCESS),
    }
}

/// On the first signal the worker stores a checkpoint and releases its job; on the second it exits immediately.
fn stop_on_signals(stop: CancellationToken) -> std::io::Result<()> {
    on_stop(move |request| match request {
        StopRequest::Save => {
            tracing::info!("stopping; the running job is returned to the queue");
            stop.cancel();
        }
        StopRequest::Exit { code } => {
            tracing::warn!(
                "stopped without a new checkpoint; the server returns the job to the queue when its lease ends"
            );
            std::process::exit(code);
        }
    })
}
