//! The local workers of this server: start, heartbeats and end.

use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use async_trait::async_trait;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use crate::jobs::Jobs;
use crate::store::{Claimant, StoreError};
use crate::worker::{
    self, ClaimOutcome, DeviceHandle, JobOutcome, JobSource, JobSourceError, LocalJobs, OpenedDevice,
    TrainingOptions, WorkerOptions,
};
use relume_api::work::WorkerHello;
use relume_engine::{DeviceChoice, DeviceError};

/// The devices of a server that train.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum Trainers {
    /// The rendering device.
    #[default]
    One,
    /// The rendering device and others.
    AlsoOn(Vec<DeviceChoice>),
    /// None; only remote workers train.
    None,
}

/// The configuration of the local workers.
pub(super) struct LocalWorkersConfig {
    pub(super) options: WorkerOptions,
    pub(super) trainers: Trainers,
    /// Labels of the workers.
    pub(super) labels: Vec<String>,
    /// Time without a heartbeat after which a worker is considered dead.
    pub(super) heartbeat_timeout: Duration,
}

/// Why the workers do not start.
#[derive(Debug, thiserror::Error)]
pub(super) enum LocalWorkersError {
    /// A device is not available.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// The database failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The operating system refused a thread.
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

/// The workers of a server.
pub(super) struct LocalWorkers {
    /// The device that renders, and trains unless training is disabled.
    pub(super) device: DeviceHandle,
    pub(super) threads: WorkerThreads,
    pub(super) registry: WorkerRegistry,
}

/// Threads that end when the server stops.
pub(super) struct WorkerThreads {
    device: JoinHandle<()>,
    trainers: Vec<JoinHandle<Option<JobOutcome>>>,
}

impl WorkerThreads {
    /// Waits for all threads.
    pub(super) async fn join(self) {
        let join = move || {
            let device = self.device.join().is_ok();
            self.trainers.into_iter().fold(device, |well, thread| thread.join().is_ok() && well)
        };
        if !tokio::task::spawn_blocking(join).await.unwrap_or(false) {
            tracing::error!("a training thread panicked");
        }
    }
}

/// Starts the workers of a server.
pub(super) async fn start(
    plan: LocalWorkersConfig,
    jobs: &Jobs,
    server: &str,
    stop: &CancellationToken,
) -> Result<LocalWorkers, LocalWorkersError> {
    let device = OpenedDevice::open(plan.options.device)?;
    let mut registry = WorkerRegistry {
        server: server.to_owned(),
        workers: Vec::new(),
        last_ms: jobs.now_ms(),
        heartbeat_timeout: plan.heartbeat_timeout,
    };
    let source: Arc<dyn JobSource> = match &plan.trainers {
        Trainers::None => Arc::new(EmptyJobSource(jobs.clone())),
        Trainers::One | Trainers::AlsoOn(_) => registry.register(&plan.labels, jobs, &device),
    };
    let mut trainers = Vec::new();
    if let Trainers::AlsoOn(choices) = &plan.trainers {
        for choice in choices {
            let device = OpenedDevice::open(*choice)?;
            let source = registry.register(&plan.labels, jobs, &device);
            let options = TrainingOptions { import_limits: plan.options.import_limits, once: false };
            trainers.push(worker::start_training(source, device, options, stop.clone())?);
        }
    }
    registry.heartbeat(jobs).await?;
    let (device, thread) = worker::start(source, device, plan.options, stop.clone())?;
    Ok(LocalWorkers { device, threads: WorkerThreads { device: thread, trainers }, registry })
}

/// Records the heartbeats of the local workers and reclaims leases.
pub(super) struct WorkerRegistry {
    server: String,
    workers: Vec<WorkerHello>,
    last_ms: i64,
    heartbeat_timeout: Duration,
}

impl WorkerRegistry {
    /// Registers a local worker and returns its job source.
    fn register(&mut self, labels: &[String], jobs: &Jobs, device: &OpenedDevice) -> Arc<dyn JobSource> {
        let hello = WorkerHello {
            id: jobs.fresh_id(),
            name: format!("server {}", self.workers.len() + 1),
            device: device.device().name(),
            has_gpu: device.device().is_gpu(),
            labels: labels.to_vec(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
        };
        let (worker, has_gpu, labels) = (Some(hello.id.clone()), hello.has_gpu, hello.labels.clone());
        self.workers.push(hello);
        Arc::new(LocalJobs::new(jobs.clone(), Claimant { worker, has_gpu, labels }))
    }

    /// Maximum time between two calls of [`Self::heartbeat`], so that missing heartbeats are detected soon.
    pub(super) fn interval(&self) -> Duration {
        self.heartbeat_timeout / 3
    }

    /// Records heartbeats of this server's workers and reclaims leases.
    ///
    /// # Errors
    /// When the database fails.
    pub(super) async fn heartbeat(&mut self, jobs: &Jobs) -> Result<(), StoreError> {
        let now = jobs.now_ms();
        for hello in &self.workers {
            jobs.record_worker_heartbeat(hello, Some(&self.server)).await?;
        }
        // After suspension of the machine or an outage of the database, all workers count as alive.
        if u128::try_from(now.saturating_sub(self.last_ms)).unwrap_or(0)
            > self.heartbeat_timeout.as_millis() / 2
        {
            jobs.store().reset_heartbeats(now).await?;
        }
        self.last_ms = now;
        jobs.reclaim_expired().await?;
        jobs.remove_workers(None).await
    }
}

/// The job source of a server that does not train.
struct EmptyJobSource(Jobs);

#[async_trait(?Send)]
impl JobSource for EmptyJobSource {
    async fn claim(&self) -> Result<ClaimOutcome, JobSourceError> {
        Ok(ClaimOutcome::Nothing)
    }

    fn changes(&self) -> watch::Receiver<()> {
        self.0.subscribe()
    }

    fn now_ms(&self) -> i64 {
        self.0.now_ms()
    }
}
