//! Leases: a worker's right to write to a job. Each write of the worker carries the lease token, so that a worker that was
//! suspended for too long detects the loss of the job and publishes nothing.

use std::time::Duration;

use crate::jobs::queue::Jobs;
use crate::store::{Claimant, JobRecord, ModelFile, ModelRecord, QualityResult, StagedUpload, StoreError};
use relume_api::JobId;
use relume_api::jobs::{JobProgress, JobState};
use relume_api::quality::Figures;
use relume_api::work::{LeaseStatus, Release, Task};

/// Maximum number of retries of a worker's write while the database cannot be reached, and the delay between them.
const MAX_RETRIES: u32 = 60;
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// One attempt at one job.
pub struct Lease {
    jobs: Jobs,
    job: JobRecord,
    token: String,
}

impl Jobs {
    /// Claims the next job for an unregistered worker that can run all jobs that require no labels.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn claim(&self) -> Result<Option<Lease>, StoreError> {
        self.claim_as(&Claimant { has_gpu: true, ..Claimant::default() }).await
    }

    /// Claims the next job that a worker can run.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn claim_as(&self, claimant: &Claimant) -> Result<Option<Lease>, StoreError> {
        let (token, now) = (self.fresh_id::<String>(), self.now_ms());
        let job = self.store.claim_job(claimant, &token, now, self.lease_end(now)).await?;
        if let Some(job) = &job {
            self.announce(&job.id);
        }
        Ok(job.map(|job| Lease { jobs: self.clone(), job, token }))
    }

    /// The lease with `token`, if it is still held.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn lease(&self, job: &JobId, token: &str) -> Result<Option<Lease>, StoreError> {
        let job = self.store.leased_job(job, token).await?;
        Ok(job.map(|job| Lease { jobs: self.clone(), job, token: token.to_owned() }))
    }
}

impl Lease {
    /// The job at the time of the claim.
    pub fn job(&self) -> &JobRecord {
        &self.job
    }

    /// The token of the lease.
    pub fn token(&self) -> &str {
        &self.token
    }

    /// The job as the worker receives it.
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

    /// Key prefix of the files of this attempt. Each attempt has its own prefix.
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

    /// Whether another job should run before this one; see [`Store::should_yield`](crate::store::Store::should_yield).
    ///
    /// # Errors
    /// When the database fails.
    pub async fn should_yield(&self) -> Result<bool, StoreError> {
        self.jobs.store.should_yield(&self.job.id, &self.token, self.jobs.now_ms()).await
    }

    /// Records progress. This is the heartbeat: it is called after a step and at no other time.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn progress(&self, progress: &JobProgress) -> Result<LeaseStatus, StoreError> {
        let now = self.jobs.now_ms();
        let until = self.jobs.lease_end(now);
        let record = || self.jobs.store.record_progress(&self.job.id, &self.token, progress, now, until);
        let status = with_retries(record).await?;
        self.jobs.announce(&self.job.id);
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
        self.jobs.announce(&self.job.id);
        Ok(status)
    }

    /// Stores a checkpoint, records it for the job, then removes the one that it replaces. Each checkpoint has a unique key, even
    /// at the same step, so that a recorded checkpoint is neither overwritten nor removed together with a failed one.
    ///
    /// # Errors
    /// When the bytes cannot be stored or the database fails. The previous checkpoint is then kept.
    pub async fn checkpoint(&self, step: i64, bytes: Vec<u8>) -> Result<LeaseStatus, StoreError> {
        let size = bytes.len() as u64;
        let key = self.checkpoint_key(step);
        let stored = match self.jobs.store.artifacts().put(&key, bytes).await {
            Ok(sha256) => self.adopt_checkpoint(step, key, sha256).await,
            Err(error) => Err(error),
        };
        self.note_disk_shortage(stored, size)
    }

    /// As [`Self::checkpoint`], for bytes that have already arrived.
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

    /// Records a stored checkpoint for the job.
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

    /// Publishes the model and ends the job as succeeded, or as rejected if `figures` miss its quality gate. With any other
    /// result than [`LeaseStatus::Held`] nothing was published.
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

    /// Removes the checkpoint of a job that has ended, after the end is durable.
    async fn ended(&self, status: LeaseStatus, checkpoint: Option<String>) {
        if let (LeaseStatus::Held, Some(key)) = (status, checkpoint) {
            self.jobs.store.artifacts().remove(&key).await;
        }
        self.jobs.announce(&self.job.id);
    }

    /// Records a shortage if there was no disk space for `size` bytes. No job is then claimed until there is.
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

    /// Returns the job to the queue.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn release(&self, release: Release) -> Result<LeaseStatus, StoreError> {
        let now = self.jobs.now_ms();
        let status = self.jobs.store.release_job(&self.job.id, &self.token, release, now).await?;
        self.jobs.announce(&self.job.id);
        Ok(status)
    }

    /// Whether the number of attempts without a new checkpoint, including this one, has reached the policy's maximum.
    pub fn is_last_attempt(&self) -> bool {
        self.job.idle_attempts >= i64::from(self.jobs.policy.max_idle_attempts)
    }

    /// The queue of this lease.
    pub fn jobs(&self) -> &Jobs {
        &self.jobs
    }
}

/// Performs an idempotent operation, and retries it while the database cannot be reached, at most [`MAX_RETRIES`] times.
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
