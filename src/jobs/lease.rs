//! A worker's right to work on a job. Whatever the worker writes carries the lease token, so that a worker which was paused
//! for too long finds out that it lost the job and publishes nothing.

use std::time::Duration;

use crate::jobs::queue::Jobs;
use crate::store::{Claimant, JobRecord, ModelFile, ModelRecord, QualityResult, StagedUpload, StoreError};
use relume_api::JobId;
use relume_api::jobs::{JobProgress, JobState};
use relume_api::quality::Figures;
use relume_api::work::{LeaseStatus, Release, Task};

/// How often a worker tries again what the database could not be reached for, and how long it waits in between.
const MAX_RETRIES: u32 = 60;
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// One attempt at one job.
pub struct Lease {
    jobs: Jobs,
    job: JobRecord,
    token: String,
}

impl Jobs {
    /// Claims the next job for a worker that is not registered and may have any that asks for no label.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn claim(&self) -> Result<Option<Lease>, StoreError> {
        self.claim_as(&Claimant { has_gpu: true, ..Claimant::default() }).await
    }

    /// Claims the next job that a worker may have.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn claim_as(&self, claimant: &Claimant) -> Result<Option<Lease>, StoreError> {
        let (token, now) = (self.fresh_id::<String>(), self.now_ms());
        let job = self.store.claim_job(claimant, &token, now, self.lease_end(now)).await?;
        if job.is_some() {
            self.announce();
        }
        Ok(job.map(|job| Lease { jobs: self.clone(), job, token }))
    }

    /// The lease of a worker that sends its token along, while it stands.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn lease(&self, job: &JobId, token: &str) -> Result<Option<Lease>, StoreError> {
        let job = self.store.leased_job(job, token).await?;
        Ok(job.map(|job| Lease { jobs: self.clone(), job, token: token.to_owned() }))
    }
}

impl Lease {
    /// The job as it was when it was claimed.
    pub fn job(&self) -> &JobRecord {
        &self.job
    }

    /// What carries this right along.
    pub fn token(&self) -> &str {
        &self.token
    }

    /// The job as its worker sees it.
    pub fn task(&self) -> Task {
        let job = &self.job;
        Task {
            job: job.id.clone(),
            request: job.request.clone(),
            attempt: job.attempts,
            is_last_attempt: self.is_last_attempt(),
            total: job.progress.total,
            checkpoint_step: job.checkpoint.as_ref().and(job.checkpoint_step),
            traceparent: job.traceparent.clone(),
        }
    }

    /// Key prefix for what this attempt writes; no other attempt shares it.
    pub fn artifact_prefix(&self) -> String {
        format!("attempts/{}/{}", self.job.id, self.job.attempts)
    }

    /// Whether the lease is still valid. Changes nothing.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn check(&self) -> Result<LeaseStatus, StoreError> {
        self.jobs.store.lease_status(&self.job.id, &self.token).await
    }

    /// Records progress. This is the heartbeat: it is called when a step was done and at no other time.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn progress(&self, progress: &JobProgress) -> Result<LeaseStatus, StoreError> {
        let now = self.jobs.now_ms();
        let until = self.jobs.lease_end(now);
        let record = || self.jobs.store.record_progress(&self.job.id, &self.token, progress, now, until);
        let status = with_retries(record).await?;
        self.jobs.announce();
        Ok(status)
    }

    /// Records a warning for the user.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn warn(&self, message: &str) -> Result<LeaseStatus, StoreError> {
        let now = self.jobs.now_ms();
        let record = || self.jobs.store.record_warning(&self.job.id, &self.token, message, now);
        let status = with_retries(record).await?;
        self.jobs.announce();
        Ok(status)
    }

    /// Stores a checkpoint, then points the job at it, then drops the one it replaces. Each has a key of its own, also a second
    /// one of the same step: the one that counts is not written over, and not taken away with one that came to nothing.
    ///
    /// # Errors
    /// When the bytes cannot be stored or the database fails; the previous checkpoint then still counts.
    pub async fn checkpoint(&self, step: i64, bytes: Vec<u8>) -> Result<LeaseStatus, StoreError> {
        let size = bytes.len() as u64;
        let key = self.checkpoint_key(step);
        let stored = match self.jobs.store.artifacts().put(&key, bytes).await {
            Ok(sha256) => self.adopt_checkpoint(step, key, sha256).await,
            Err(error) => Err(error),
        };
        self.note_disk_shortage(stored, size)
    }

    /// As [`Self::checkpoint`], of bytes that have arrived already.
    ///
    /// # Errors
    /// As [`Self::checkpoint`].
    pub async fn take_checkpoint(&self, step: i64, bytes: StagedUpload) -> Result<LeaseStatus, StoreError> {
        let (key, sha256) = (self.checkpoint_key(step), bytes.sha256.clone());
        self.jobs.store.artifacts().publish(bytes, &key).await?;
        self.adopt_checkpoint(step, key, sha256).await
    }

    fn checkpoint_key(&self, step: i64) -> String {
        let unique: String = self.jobs.fresh_id();
        format!("{}/checkpoint-{step:08}-{unique}.safetensors", self.artifact_prefix())
    }

    /// Points the job at a checkpoint that is stored.
    async fn adopt_checkpoint(
        &self,
        step: i64,
        key: String,
        sha256: String,
    ) -> Result<LeaseStatus, StoreError> {
        let store = &self.jobs.store;
        let (artifact, now) = ((key.as_str(), sha256.as_str()), self.jobs.now_ms());
        let record = || store.record_checkpoint(&self.job.id, &self.token, artifact, step, now);
        let recorded = with_retries(record).await;
        if matches!(recorded, Err(StoreError::Full)) {
            store.artifacts().remove(&key).await;
        }
        let (status, replaced) = recorded?;
        match status {
            LeaseStatus::Lost => store.artifacts().remove(&key).await,
            LeaseStatus::Held | LeaseStatus::Cancelling => {
                if let Some(replaced) = replaced {
                    store.artifacts().remove(&replaced).await;
                }
            }
        }
        Ok(status)
    }

    /// Publishes the model and ends the job as succeeded, or as rejected when `figures` are not what it asks for. Anything but [`LeaseStatus::Held`] published nothing.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn publish(
        &self,
        model: &ModelRecord,
        files: &[ModelFile],
        figures: Figures,
    ) -> Result<LeaseStatus, StoreError> {
        let measured = QualityResult::new(figures, &self.job.request.quality_gate);
        let now = self.jobs.now_ms();
        let checkpoint = self.current_checkpoint().await?;
        let status = self.jobs.store.publish_model(&self.token, model, files, &measured, now).await?;
        self.ended(status, checkpoint).await;
        Ok(status)
    }

    /// Ends the job as failed.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn fail(&self, code: &str, detail: &str) -> Result<LeaseStatus, StoreError> {
        self.end(JobState::Failed, Some((code, detail))).await
    }

    /// Ends the job as cancelled.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn confirm_cancel(&self) -> Result<LeaseStatus, StoreError> {
        self.end(JobState::Cancelled, None).await
    }

    async fn end(&self, state: JobState, error: Option<(&str, &str)>) -> Result<LeaseStatus, StoreError> {
        let now = self.jobs.now_ms();
        let checkpoint = self.current_checkpoint().await?;
        let status = self.jobs.store.end_job(&self.job.id, &self.token, state, error, now).await?;
        self.ended(status, checkpoint).await;
        Ok(status)
    }

    async fn current_checkpoint(&self) -> Result<Option<String>, StoreError> {
        Ok(self.jobs.store.job(&self.job.tenant, &self.job.id).await?.and_then(|job| job.checkpoint))
    }

    /// Removes the checkpoint of a job that has ended, once the end is durable.
    async fn ended(&self, status: LeaseStatus, checkpoint: Option<String>) {
        if let (LeaseStatus::Held, Some(key)) = (status, checkpoint) {
            self.jobs.store.artifacts().remove(&key).await;
        }
        self.jobs.announce();
    }

    /// Where no room was left for `size` bytes, nothing is claimed until there is.
    pub(super) fn note_disk_shortage<T>(
        &self,
        stored: Result<T, StoreError>,
        size: u64,
    ) -> Result<T, StoreError> {
        if matches!(stored, Err(StoreError::Full)) {
            self.jobs.store.disk_space().note_shortage(size);
        }
        stored
    }

    /// Gives the job back to the queue.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn release(&self, release: Release) -> Result<LeaseStatus, StoreError> {
        let now = self.jobs.now_ms();
        let status = self.jobs.store.release_job(&self.job.id, &self.token, release, now).await?;
        self.jobs.announce();
        Ok(status)
    }

    /// True when the attempts without a new checkpoint, this one included, have reached the policy's maximum.
    pub fn is_last_attempt(&self) -> bool {
        self.job.idle_attempts >= i64::from(self.jobs.policy.max_idle_attempts)
    }

    /// The queue this lease belongs to.
    pub fn jobs(&self) -> &Jobs {
        &self.jobs
    }
}

/// Does what can be done twice, and again while the database cannot be reached, for [`MAX_RETRIES`] tries.
async fn with_retries<T, F: Future<Output = Result<T, StoreError>>>(
    act: impl Fn() -> F,
) -> Result<T, StoreError> {
    for _ in 0..MAX_RETRIES {
        match act().await {
            Err(StoreError::DatabaseUnreachable(_)) => tokio::time::sleep(RETRY_INTERVAL).await,
            done => return done,
        }
    }
    act().await
}
