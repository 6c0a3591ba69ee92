//! The source of a worker's jobs and the destination of their results: the queue of this process, or a server over the API.

use std::path::PathBuf;

use async_trait::async_trait;
use tokio::sync::watch;
use tokio_util::bytes::Bytes;

use relume_api::jobs::JobProgress;
use relume_api::quality::Figures;
use relume_api::work::{LeaseStatus, Release, Task};
use relume_api::{EnvironmentId, WorkerId};

/// Why a request to a job source failed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum JobSourceError {
    /// There is not enough space to store the data.
    #[error("the disk is full")]
    Full,
    /// The database, the object store or the server cannot be reached at present.
    #[error("{0}")]
    Unreachable(String),
    /// A resource of the job no longer exists.
    #[error("a resource of the job no longer exists")]
    Gone,
    /// A stored file is damaged or missing.
    #[error("a stored file that the job needs is damaged or missing; upload it again")]
    Damaged,
    /// The worker is not permitted to run jobs; a retry cannot help.
    #[error("{0}")]
    Refused(String),
    /// Any other failure; the message is for the log.
    #[error("{0}")]
    Failed(String),
}

/// The result of a claim.
pub enum ClaimOutcome {
    /// A job.
    Job(Box<dyn Claim>),
    /// No job that the worker can run is queued.
    Nothing,
    /// The worker is drained and must exit.
    Draining,
}

/// Provides jobs to a worker.
#[async_trait(?Send)]
pub trait JobSource: Send + Sync {
    /// Claims the next job for the worker. The future must be polled to its end, because a claimed job without a worker is lost
    /// until its lease ends.
    ///
    /// # Errors
    /// See [`JobSourceError`].
    async fn claim(&self) -> Result<ClaimOutcome, JobSourceError>;

    /// The identity of the worker, if it is registered.
    fn worker(&self) -> Option<&WorkerId> {
        None
    }

    /// Notifies when a job may be queued, or the current job may have been asked to stop.
    fn changes(&self) -> watch::Receiver<()>;

    /// The current time, milliseconds since 1970 UTC.
    fn now_ms(&self) -> i64;
}

/// One attempt at one job. After its lease is lost, its writes have no effect.
#[async_trait(?Send)]
pub trait Claim {
    /// The job.
    fn task(&self) -> &Task;

    /// The local path of the capture's archive, verified by its hash.
    async fn capture(&self) -> Result<PathBuf, JobSourceError>;

    /// The local path of an uploaded environment map, and its hash.
    async fn environment(&self, id: &EnvironmentId) -> Result<(PathBuf, String), JobSourceError>;

    /// The bytes of the last checkpoint.
    async fn last_checkpoint(&self) -> Result<Bytes, JobSourceError>;

    /// Whether the lease is valid. Changes nothing.
    async fn check(&self) -> Result<LeaseStatus, JobSourceError>;

    /// Whether another job should run before this one. Changes nothing.
    async fn should_yield(&self) -> Result<bool, JobSourceError>;

    /// Reports progress, which renews the lease.
    async fn progress(&self, progress: &JobProgress) -> Result<LeaseStatus, JobSourceError>;

    /// Records a warning for the user.
    async fn warn(&self, message: &str) -> Result<LeaseStatus, JobSourceError>;

    /// Stores a checkpoint. After an error the previous checkpoint is kept.
    async fn checkpoint(&self, step: i64, bytes: Vec<u8>) -> Result<LeaseStatus, JobSourceError>;

    /// Publishes the model and ends the job. With any other result than [`LeaseStatus::Held`] nothing was published.
    async fn publish(&self, model: TrainedModel) -> Result<LeaseStatus, JobSourceError>;

    /// Ends the job as failed.
    async fn fail(&self, code: &str, detail: &str) -> Result<LeaseStatus, JobSourceError>;

    /// Ends the job as cancelled.
    async fn confirm_cancel(&self) -> Result<LeaseStatus, JobSourceError>;

    /// Returns the job to the queue.
    async fn release(&self, release: Release) -> Result<LeaseStatus, JobSourceError>;
}

/// The result of a training.
#[derive(Debug, Clone)]
pub struct TrainedModel {
    /// Number of Gaussians.
    pub gaussians: i64,
    /// The model card, with the training time.
    pub card: serde_json::Value,
    /// The accuracy on held-out views.
    pub figures: Figures,
    /// Names and bytes of the files.
    pub files: Vec<(&'static str, Vec<u8>)>,
}
