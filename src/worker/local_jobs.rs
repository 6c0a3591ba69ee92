//! The job source of local workers: the queue in the store of this process.

use std::path::PathBuf;

use async_trait::async_trait;
use tokio::sync::watch;
use tokio_util::bytes::Bytes;

use crate::jobs::{Jobs, Lease};
use crate::store::{Claimant, StoreError};
use crate::worker::job_source::{Claim, ClaimOutcome, JobSource, JobSourceError, TrainedModel};
use relume_api::jobs::JobProgress;
use relume_api::work::{FinishedModel, LeaseStatus, Release, Task};
use relume_api::{EnvironmentId, WorkerId};

/// The queue of this process, for one worker.
pub struct LocalJobs {
    jobs: Jobs,
    claimant: Claimant,
}

impl LocalJobs {
    /// A source for a worker.
    pub fn new(jobs: Jobs, claimant: Claimant) -> Self {
        Self { jobs, claimant }
    }

    /// Whether there is less disk space than the last failed write needs. Then no job is claimed.
    async fn lacks_disk_space(&self) -> bool {
        let store = self.jobs.store();
        if !store.disk_space().is_short() {
            return false;
        }
        if let Ok(false) = self.jobs.has_queued_jobs().await {
            store.disk_space().forget_shortage();
        }
        match store.check_disk_space().await {
            Ok(()) => {
                tracing::info!("disk space is available again");
                false
            }
            Err(error) => {
                tracing::debug!(%error, "queued jobs wait for disk space");
                true
            }
        }
    }
}

#[async_trait(?Send)]
impl JobSource for LocalJobs {
    async fn claim(&self) -> Result<ClaimOutcome, JobSourceError> {
        if self.lacks_disk_space().await {
            return Ok(ClaimOutcome::Nothing);
        }
        match self.jobs.claim_as(&self.claimant).await {
            Ok(lease) => Ok(lease
                .map_or(ClaimOutcome::Nothing, |lease| ClaimOutcome::Job(Box::new(LocalClaim::new(lease))))),
            Err(error) => {
                if matches!(error, StoreError::Full) {
                    self.jobs.store().disk_space().note_shortage(1);
                }
                Err(error.into())
            }
        }
    }

    fn worker(&self) -> Option<&WorkerId> {
        self.claimant.worker.as_ref()
    }

    fn changes(&self) -> watch::Receiver<()> {
        self.jobs.subscribe()
    }

    fn now_ms(&self) -> i64 {
        self.jobs.now_ms()
    }
}

/// A lease on a job of the store.
struct LocalClaim {
    lease: Lease,
    task: Task,
}

impl LocalClaim {
    fn new(lease: Lease) -> Self {
        Self { task: lease.task(), lease }
    }

    /// Performs a write that ends an attempt. On a full disk it releases the reserve first.
    async fn with_disk_reserve(
        &self,
        end: impl AsyncFn() -> Result<LeaseStatus, StoreError>,
    ) -> Result<LeaseStatus, JobSourceError> {
        let disk_space = self.lease.jobs().store().disk_space();
        match end().await {
            Err(StoreError::Full) => {
                disk_space.note_shortage(1);
                if disk_space.spend_reserve() { Ok(end().await?) } else { Err(JobSourceError::Full) }
            }
            ended => Ok(ended?),
        }
    }
}

#[async_trait(?Send)]
impl Claim for LocalClaim {
    fn task(&self) -> &Task {
        &self.task
    }

    async fn capture(&self) -> Result<PathBuf, JobSourceError> {
        let file = self.lease.capture().await?.ok_or(JobSourceError::Gone)?;
        Ok(self.lease.bring(&file).await?)
    }

    async fn environment(&self, id: &EnvironmentId) -> Result<(PathBuf, String), JobSourceError> {
        let file = self.lease.environment(id).await?.ok_or(JobSourceError::Gone)?;
        Ok((self.lease.bring(&file).await?, file.sha256))
    }

    async fn last_checkpoint(&self) -> Result<Bytes, JobSourceError> {
        let file = self.lease.last_checkpoint().ok_or(JobSourceError::Gone)?;
        self.lease.bring(&file).await?;
        Ok(self.lease.jobs().store().artifacts().get(&file.artifact).await?)
    }

    async fn check(&self) -> Result<LeaseStatus, JobSourceError> {
        Ok(self.lease.check().await?)
    }

    async fn should_yield(&self) -> Result<bool, JobSourceError> {
        Ok(self.lease.should_yield().await?)
    }

    async fn progress(&self, progress: &JobProgress) -> Result<LeaseStatus, JobSourceError> {
        Ok(self.lease.progress(progress).await?)
    }

    async fn warn(&self, message: &str) -> Result<LeaseStatus, JobSourceError> {
        Ok(self.lease.warn(message).await?)
    }

    async fn checkpoint(&self, step: i64, bytes: Vec<u8>) -> Result<LeaseStatus, JobSourceError> {
        Ok(self.lease.checkpoint(step, bytes).await?)
    }

    async fn publish(&self, model: TrainedModel) -> Result<LeaseStatus, JobSourceError> {
        let TrainedModel { gaussians, card, figures, files } = model;
        let mut sent = Vec::with_capacity(files.len());
        for (name, bytes) in files {
            match self.lease.put_file(name, bytes).await {
                Ok(file) => sent.push(file),
                Err(error) => {
                    self.lease.discard(sent.iter().map(|file| file.name.as_str())).await;
                    return Err(error.into());
                }
            }
        }
        Ok(self.lease.finish(FinishedModel { gaussians, card, figures, files: sent }).await?)
    }

    async fn fail(&self, code: &str, detail: &str) -> Result<LeaseStatus, JobSourceError> {
        self.with_disk_reserve(async || self.lease.fail(code, detail).await).await
    }

    async fn confirm_cancel(&self) -> Result<LeaseStatus, JobSourceError> {
        self.with_disk_reserve(async || self.lease.confirm_cancel().await).await
    }

    async fn release(&self, release: Release) -> Result<LeaseStatus, JobSourceError> {
        self.with_disk_reserve(async || self.lease.release(release).await).await
    }
}

impl From<StoreError> for JobSourceError {
    fn from(error: StoreError) -> Self {
        match error {
            StoreError::Full => Self::Full,
            StoreError::DatabaseUnreachable(_) => {
                Self::Unreachable("the database cannot be reached".to_owned())
            }
            StoreError::ArtifactsUnreachable(_) => {
                Self::Unreachable("the object store cannot be reached".to_owned())
            }
            StoreError::Damaged(_) | StoreError::Missing(_) => {
                tracing::error!(%error, "a stored file of a running job is damaged or missing");
                Self::Damaged
            }
            error => Self::Failed(error.to_string()),
        }
    }
}
