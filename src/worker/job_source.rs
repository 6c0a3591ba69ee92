//! Where a worker's jobs come from and what it makes of them goes: the queue of this process, or that of a server elsewhere.

use std::path::PathBuf;

use async_trait::async_trait;
use tokio::sync::watch;
use tokio_util::bytes::Bytes;

use relume_api::jobs::JobProgress;
use relume_api::quality::Figures;
use relume_api::work::{LeaseStatus, Release, Task};
use relume_api::{EnvironmentId, WorkerId};

/// Why a source did not do what a worker asked for.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum JobSourceError {
    /// There is no room for what is to be stored.
    #[error("the disk is full")]
    Full,
    /// What keeps the jobs or the files cannot be reached for now.
    #[error("{0}")]
    Unreachable(String),
    /// What the job names is not there any more.
    #[error("it is gone")]
    Gone,
    /// A stored file is damaged or missing.
    #[error("a stored file that the job needs is damaged or missing; upload it again")]
    Damaged,
    /// The worker may not have jobs: asking again is of no use.
    #[error("{0}")]
    Refused(String),
    /// Something else, for the log.
    #[error("{0}")]
    Failed(String),
}

/// What was claimed, if anything.
pub enum ClaimOutcome {
    /// A job.
    Job(Box<dyn Claim>),
    /// No job waits that the worker may have.
    Nothing,
    /// The worker is to end.
    Draining,
}

/// Gives out jobs.
#[async_trait(?Send)]
pub trait JobSource: Send + Sync {
    /// Claims the next job for the worker. Once begun it must be waited for: a job that nobody takes is nobody's.
    ///
    /// # Errors
    /// See [`JobSourceError`].
    async fn claim(&self) -> Result<ClaimOutcome, JobSourceError>;

    /// As whom it claims them, if anybody.
    fn worker(&self) -> Option<&WorkerId> {
        None
    }

    /// Wakes when a job may wait, or what is worked on may have been asked to stop.
    fn changes(&self) -> watch::Receiver<()>;

    /// The current time, milliseconds since 1970 UTC.
    fn now_ms(&self) -> i64;
}

/// One attempt at one job. Nothing that a worker writes counts once its lease is lost.
#[async_trait(?Send)]
pub trait Claim {
    /// The job.
    fn task(&self) -> &Task;

    /// The archive of the capture on this machine, with the bytes that were uploaded.
    async fn capture(&self) -> Result<PathBuf, JobSourceError>;

    /// The file of an uploaded environment map on this machine, and its hash.
    async fn environment(&self, id: &EnvironmentId) -> Result<(PathBuf, String), JobSourceError>;

    /// The bytes of the last checkpoint.
    async fn last_checkpoint(&self) -> Result<Bytes, JobSourceError>;

    /// Whether the lease is valid. Changes nothing.
    async fn check(&self) -> Result<LeaseStatus, JobSourceError>;

    /// Reports progress, which renews the lease.
    async fn progress(&self, progress: &JobProgress) -> Result<LeaseStatus, JobSourceError>;

    /// Records a warning for the user.
    async fn warn(&self, message: &str) -> Result<LeaseStatus, JobSourceError>;

    /// Stores a checkpoint; after an error the one before still counts.
    async fn checkpoint(&self, step: i64, bytes: Vec<u8>) -> Result<LeaseStatus, JobSourceError>;

    /// Publishes the model and ends the job. Anything but [`LeaseStatus::Held`] published nothing.
    async fn publish(&self, model: TrainedModel) -> Result<LeaseStatus, JobSourceError>;

    /// Ends the job as failed.
    async fn fail(&self, code: &str, detail: &str) -> Result<LeaseStatus, JobSourceError>;

    /// Ends the job as cancelled.
    async fn confirm_cancel(&self) -> Result<LeaseStatus, JobSourceError>;

    /// Gives the job back to the queue.
    async fn release(&self, release: Release) -> Result<LeaseStatus, JobSourceError>;
}

/// What a training made.
#[derive(Debug, Clone)]
pub struct TrainedModel {
    /// Number of Gaussians.
    pub gaussians: i64,
    /// The model card, with the time it took.
    pub card: serde_json::Value,
    /// What was measured on held-out views.
    pub figures: Figures,
    /// Names and bytes of the files.
    pub files: Vec<(&'static str, Vec<u8>)>,
}
