//! A job of a server, over its API. The worker sends a heartbeat every few seconds while it has the job.

use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;
use sha2::{Digest, Sha256};
use tokio::sync::watch;
use tokio_util::bytes::Bytes;

use crate::remote_worker::errors::source_error;
use crate::remote_worker::file_cache::{CacheError, FileCache};
use crate::remote_worker::observer::{Observer, WorkerEvent};
use crate::store::hex;
use crate::worker::{Claim, JobSourceError, TrainedModel};
use relume_api::EnvironmentId;
use relume_api::jobs::JobProgress;
use relume_api::work::{FinishedModel, LeaseStatus, LeaseView, Release, Task, WorkEnd};
use relume_client::work::LeasedJob;
use relume_client::{ClientError, Download};

/// Minimum time between two heartbeats.
const MIN_HEARTBEAT_INTERVAL: Duration = Duration::from_millis(100);
/// Maximum number of retries while the server cannot be reached, and the delay between them.
const MAX_RETRIES: u32 = 60;
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// The lease on a job of a server.
pub(super) struct RemoteClaim {
    work: LeasedJob,
    task: Task,
    cache: FileCache,
    observer: Observer,
    heartbeat_task: tokio::task::JoinHandle<()>,
}

impl Drop for RemoteClaim {
    fn drop(&mut self) {
        self.heartbeat_task.abort();
    }
}

impl RemoteClaim {
    /// Must be called inside a tokio runtime. `changes` notifies when the job is to stop, which the heartbeats query.
    pub(super) fn new(
        work: LeasedJob,
        task: Task,
        cache: FileCache,
        observer: Observer,
        (changes, every): (Arc<watch::Sender<()>>, Duration),
    ) -> Self {
        let heartbeat_task =
            tokio::spawn(send_heartbeats(work.clone(), changes, every.max(MIN_HEARTBEAT_INTERVAL)));
        Self { work, task, cache, observer, heartbeat_task }
    }

    async fn end(&self, end: WorkEnd) -> Result<LeaseStatus, JobSourceError> {
        lease_status(with_retries(async || self.work.end(&end).await).await)
    }

    async fn kept(&self, found: Result<Download, ClientError>) -> Result<(PathBuf, String), CacheError> {
        self.cache.keep(found?).await
    }
}

/// Sends heartbeats until the task is aborted. Notifies `changes` if the job is to stop.
async fn send_heartbeats(work: LeasedJob, changes: Arc<watch::Sender<()>>, every: Duration) {
    loop {
        tokio::time::sleep(every).await;
        match lease_status(work.heartbeat().await) {
            Ok(LeaseStatus::Held) => {}
            Ok(LeaseStatus::Cancelling | LeaseStatus::Lost) => {
                changes.send_replace(());
            }
            Err(error) => tracing::warn!(%error, "cannot send a heartbeat to the server"),
        }
    }
}

#[async_trait(?Send)]
impl Claim for RemoteClaim {
    fn task(&self) -> &Task {
        &self.task
    }

    async fn capture(&self) -> Result<PathBuf, JobSourceError> {
        let fetched = download_with_retries(async || self.kept(self.work.capture().await).await).await;
        fetched.map(|(path, _)| path)
    }

    async fn environment(&self, id: &EnvironmentId) -> Result<(PathBuf, String), JobSourceError> {
        download_with_retries(async || self.kept(self.work.environment(id).await).await).await
    }

    async fn last_checkpoint(&self) -> Result<Bytes, JobSourceError> {
        let fetched = with_retries(async || {
            let download = self.work.checkpoint().await?;
            let sha256 = download.sha256();
            Ok((download.whole().await?, sha256))
        });
        let (bytes, sha256) = fetched.await.map_err(source_error)?;
        // Checkpoints of versions that did not store hashes have none.
        let is_intact = sha256.is_empty() || hex(&Sha256::digest(&bytes)) == sha256;
        if is_intact { Ok(bytes) } else { Err(JobSourceError::Damaged) }
    }

    async fn check(&self) -> Result<LeaseStatus, JobSourceError> {
        lease_status(self.work.heartbeat().await)
    }

    async fn should_yield(&self) -> Result<bool, JobSourceError> {
        Ok(self.work.heartbeat().await.map_err(source_error)?.should_yield)
    }

    async fn progress(&self, progress: &JobProgress) -> Result<LeaseStatus, JobSourceError> {
        (self.observer)(WorkerEvent::Progress(progress));
        lease_status(with_retries(async || self.work.progress(progress).await).await)
    }

    async fn warn(&self, message: &str) -> Result<LeaseStatus, JobSourceError> {
        (self.observer)(WorkerEvent::Warning(message));
        lease_status(with_retries(async || self.work.warn(message).await).await)
    }

    async fn checkpoint(&self, step: i64, bytes: Vec<u8>) -> Result<LeaseStatus, JobSourceError> {
        let bytes = Bytes::from(bytes);
        lease_status(with_retries(async || self.work.put_checkpoint(step, bytes.clone()).await).await)
    }

    async fn publish(&self, model: TrainedModel) -> Result<LeaseStatus, JobSourceError> {
        let TrainedModel { gaussians, card, figures, files } = model;
        let mut sent = Vec::with_capacity(files.len());
        for (name, bytes) in files {
            let bytes = Bytes::from(bytes);
            match with_retries(async || self.work.put_file(name, bytes.clone()).await).await {
                Ok(file) => sent.push(file),
                Err(error) => return lost_lease_or(error),
            }
        }
        let model = FinishedModel { gaussians, card, figures, files: sent };
        let status = lease_status(with_retries(async || self.work.publish(&model).await).await)?;
        if status == LeaseStatus::Held {
            (self.observer)(WorkerEvent::Published);
        }
        Ok(status)
    }

    async fn fail(&self, code: &str, detail: &str) -> Result<LeaseStatus, JobSourceError> {
        (self.observer)(WorkerEvent::Failed(detail));
        self.end(WorkEnd::Failed { code: code.to_owned(), detail: detail.to_owned() }).await
    }

    async fn confirm_cancel(&self) -> Result<LeaseStatus, JobSourceError> {
        (self.observer)(WorkerEvent::Cancelled);
        self.end(WorkEnd::Cancelled).await
    }

    async fn release(&self, release: Release) -> Result<LeaseStatus, JobSourceError> {
        (self.observer)(WorkerEvent::Released);
        self.end(WorkEnd::Released { why: release }).await
    }
}

/// The status of the lease according to an answer.
fn lease_status(answer: Result<LeaseView, ClientError>) -> Result<LeaseStatus, JobSourceError> {
    match answer {
        Ok(view) => Ok(view.status),
        Err(error) => lost_lease_or(error),
    }
}

fn lost_lease_or(error: ClientError) -> Result<LeaseStatus, JobSourceError> {
    let is_lost = error.problem().is_some_and(|problem| problem.kind.ends_with("lease-lost"));
    if is_lost { Ok(LeaseStatus::Lost) } else { Err(source_error(error)) }
}

/// Whether a retry may succeed.
fn is_transient(error: &ClientError) -> bool {
    match error {
        ClientError::Transport(_) => true,
        error => error.problem().is_some_and(|problem| matches!(problem.status, 408 | 429 | 502..=504)),
    }
}

/// Performs an idempotent operation, and retries it while the server cannot be reached, at most [`MAX_RETRIES`] times.
async fn with_retries<T>(act: impl AsyncFn() -> Result<T, ClientError>) -> Result<T, ClientError> {
    for _ in 0..MAX_RETRIES {
        match act().await {
            Err(error) if is_transient(&error) => tokio::time::sleep(RETRY_INTERVAL).await,
            done => return done,
        }
    }
    act().await
}

/// As [`with_retries`], for a file. A file with a wrong hash is downloaded once more.
async fn download_with_retries<T>(act: impl AsyncFn() -> Result<T, CacheError>) -> Result<T, JobSourceError> {
    let mut wrong = 0;
    for _ in 0..MAX_RETRIES {
        match act().await {
            Err(CacheError::Client(error)) if is_transient(&error) => {
                tokio::time::sleep(RETRY_INTERVAL).await
            }
            Err(CacheError::Io(error)) if error.kind() == io::ErrorKind::TimedOut => {
                tokio::time::sleep(RETRY_INTERVAL).await;
            }
            Err(CacheError::WrongBytes) if wrong == 0 => wrong += 1,
            Ok(done) => return Ok(done),
            Err(CacheError::Client(error)) => return Err(source_error(error)),
            Err(CacheError::WrongBytes) => return Err(JobSourceError::Damaged),
            Err(CacheError::Io(error)) if error.kind() == io::ErrorKind::StorageFull => {
                return Err(JobSourceError::Full);
            }
            Err(error @ CacheError::Io(_)) => return Err(JobSourceError::Failed(error.to_string())),
        }
    }
    Err(JobSourceError::Unreachable("the server cannot be reached".to_owned()))
}
