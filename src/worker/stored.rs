//! Jobs of the store that this process works on itself.

use std::path::PathBuf;

use async_trait::async_trait;
use tokio::sync::watch;
use tokio_util::bytes::Bytes;

use crate::api::jobs::JobProgress;
use crate::api::work::{FinishedModel, LeaseStatus, Release, Task};
use crate::api::{EnvironmentId, WorkerId};
use crate::jobs::{Jobs, Lease};
use crate::store::{Claimant, StoreError};
use crate::worker::source::{Claim, Claimed, Source, SourceError, TrainedModel};

/// The queue of this process for one worker.
pub struct StoredJobs {
    jobs: Jobs,
    claimant: Claimant,
}

impl StoredJobs {
    /// The queue for a worker.
    pub fn new(jobs: Jobs, claimant: Claimant) -> Self {
        Self { jobs, claimant }
    }

    /// True while there is less room than the last write that did not fit would need. Nothing is claimed then.
    async fn lacks_room(&self) -> bool {
        let store = self.jobs.store();
        if !store.room().is_short() {
            return false;
        }
        if let Ok(false) = self.jobs.any_waits().await {
            store.room().forget_shortage();
        }
        match store.check_room().await {
            Ok(()) => {
                tracing::info!("there is room on the disk again");
                false
            }
            Err(error) => {
                tracing::debug!(%error, "jobs wait for room");
                true
            }
        }
    }
}

#[async_trait(?Send)]
impl Source for StoredJobs {
    async fn claim(&self) -> Result<Claimed, SourceError> {
        if self.lacks_room().await {
            return Ok(Claimed::Nothing);
        }
        match self.jobs.claim_as(&self.claimant).await {
            Ok(lease) => {
                Ok(lease.map_or(Claimed::Nothing, |lease| Claimed::Job(Box::new(StoredClaim::new(lease)))))
            }
            Err(error) => {
                if matches!(error, StoreError::Full) {
                    self.jobs.store().room().note_shortage(1);
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
struct StoredClaim {
    lease: Lease,
    task: Task,
}

impl StoredClaim {
    fn new(lease: Lease) -> Self {
        Self { task: lease.task(), lease }
    }

    /// Does what ends an attempt. On a full disk the reserve is given up for it.
    async fn even_on_a_full_disk(
        &self,
        end: impl AsyncFn() -> Result<LeaseStatus, StoreError>,
    ) -> Result<LeaseStatus, SourceError> {
        let room = self.lease.jobs().store().room();
        match end().await {
            Err(StoreError::Full) => {
                room.note_shortage(1);
                if room.spend_reserve() { Ok(end().await?) } else { Err(SourceError::Full) }
            }
            ended => Ok(ended?),
        }
    }
}

#[async_trait(?Send)]
impl Claim for StoredClaim {
    fn task(&self) -> &Task {
        &self.task
    }

    async fn capture(&self) -> Result<PathBuf, SourceError> {
        let file = self.lease.capture().await?.ok_or(SourceError::Gone)?;
        Ok(self.lease.bring(&file).await?)
    }

    async fn environment(&self, id: &EnvironmentId) -> Result<(PathBuf, String), SourceError> {
        let file = self.lease.environment(id).await?.ok_or(SourceError::Gone)?;
        Ok((self.lease.bring(&file).await?, file.sha256))
    }

    async fn last_checkpoint(&self) -> Result<Bytes, SourceError> {
        let file = self.lease.last_checkpoint().ok_or(SourceError::Gone)?;
        self.lease.bring(&file).await?;
        Ok(self.lease.jobs().store().artifacts().get(&file.artifact).await?)
    }

    async fn check(&self) -> Result<LeaseStatus, SourceError> {
        Ok(self.lease.check().await?)
    }

    async fn progress(&self, progress: &JobProgress) -> Result<LeaseStatus, SourceError> {
        Ok(self.lease.progress(progress).await?)
    }

    async fn warn(&self, message: &str) -> Result<LeaseStatus, SourceError> {
        Ok(self.lease.warn(message).await?)
    }

    async fn checkpoint(&self, step: i64, bytes: Vec<u8>) -> Result<LeaseStatus, SourceError> {
        Ok(self.lease.checkpoint(step, bytes).await?)
    }

    async fn publish(&self, model: TrainedModel) -> Result<LeaseStatus, SourceError> {
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

    async fn fail(&self, code: &str, detail: &str) -> Result<LeaseStatus, SourceError> {
        self.even_on_a_full_disk(async || self.lease.fail(code, detail).await).await
    }

    async fn confirm_cancel(&self) -> Result<LeaseStatus, SourceError> {
        self.even_on_a_full_disk(async || self.lease.confirm_cancel().await).await
    }

    async fn release(&self, release: Release) -> Result<LeaseStatus, SourceError> {
        self.even_on_a_full_disk(async || self.lease.release(release).await).await
    }
}

impl From<StoreError> for SourceError {
    fn from(error: StoreError) -> Self {
        match error {
            StoreError::Full => Self::Full,
            StoreError::DatabaseUnreachable(_) => {
                Self::Unreachable("the database cannot be reached".to_owned())
            }
            StoreError::ArtifactsUnreachable(_) => {
                Self::Unreachable("the object store of artifacts cannot be reached".to_owned())
            }
            StoreError::Damaged(_) | StoreError::Missing(_) => {
                tracing::error!(%error, "the store failed under a job");
                Self::Damaged
            }
            error => Self::Failed(error.to_string()),
        }
    }
}
