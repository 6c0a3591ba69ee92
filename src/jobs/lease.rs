//! A worker's hold on a job. Whatever it writes carries the lease token, so that a worker which was paused for
//! too long finds out that it lost the job and publishes nothing.

use crate::jobs::Jobs;
use crate::store::{Held, JobRecord, JobState, ModelFile, ModelRecord, ProgressUpdate, StoreError};

/// One attempt at one job.
pub struct Lease {
    jobs: Jobs,
    job: JobRecord,
    token: String,
}

impl Lease {
    pub(super) fn new(jobs: Jobs, job: JobRecord, token: String) -> Self {
        Self { jobs, job, token }
    }

    /// The job as it was when it was claimed.
    pub fn job(&self) -> &JobRecord {
        &self.job
    }

    /// Key prefix for what this attempt writes; no other attempt shares it.
    pub fn artifact_prefix(&self) -> String {
        format!("attempts/{}/{}", self.job.id, self.job.attempts)
    }

    /// Whether the lease still stands. Changes nothing.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn check(&self) -> Result<Held, StoreError> {
        self.jobs.store.held(&self.job.id, &self.token).await
    }

    /// Records progress. This is the heartbeat: it is called when a step was done and at no other time.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn progress(&self, progress: &ProgressUpdate) -> Result<Held, StoreError> {
        let now = self.jobs.now_ms();
        let until = self.jobs.lease_end(now);
        let held = self.jobs.store.record_progress(&self.job.id, &self.token, progress, now, until).await?;
        self.jobs.announce();
        Ok(held)
    }

    /// Tells listeners something a user should know.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn warn(&self, message: &str) -> Result<(), StoreError> {
        self.jobs.store.record_warning(&self.job.id, message, self.jobs.now_ms()).await?;
        self.jobs.announce();
        Ok(())
    }

    /// Stores a checkpoint, then points the job at it, then drops the one it replaces.
    ///
    /// # Errors
    /// When the bytes cannot be stored or the database fails; the previous checkpoint then still counts.
    pub async fn checkpoint(&self, step: i64, bytes: Vec<u8>) -> Result<Held, StoreError> {
        let store = &self.jobs.store;
        let key = format!("{}/checkpoint-{step:08}.safetensors", self.artifact_prefix());
        store.artifacts().put(&key, bytes).await?;
        let (held, replaced) =
            store.record_checkpoint(&self.job.id, &self.token, &key, step, self.jobs.now_ms()).await?;
        match held {
            Held::Lost => store.artifacts().remove(&key).await,
            Held::Yes | Held::Cancelling => {
                if let Some(replaced) = replaced {
                    store.artifacts().remove(&replaced).await;
                }
            }
        }
        Ok(held)
    }

    /// Publishes the model and ends the job as succeeded. Anything but [`Held::Yes`] published nothing.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn publish(&self, model: &ModelRecord, files: &[ModelFile]) -> Result<Held, StoreError> {
        let now = self.jobs.now_ms();
        let checkpoint = self.last_checkpoint().await?;
        let held = self.jobs.store.publish_model(&self.token, model, files, now).await?;
        self.ended(held, checkpoint).await;
        Ok(held)
    }

    /// Ends the job as failed.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn fail(&self, code: &str, detail: &str) -> Result<Held, StoreError> {
        self.end(JobState::Failed, Some((code, detail))).await
    }

    /// Ends the job as cancelled.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn confirm_cancel(&self) -> Result<Held, StoreError> {
        self.end(JobState::Cancelled, None).await
    }

    async fn end(&self, state: JobState, error: Option<(&str, &str)>) -> Result<Held, StoreError> {
        let now = self.jobs.now_ms();
        let checkpoint = self.last_checkpoint().await?;
        let held = self.jobs.store.end_job(&self.job.id, &self.token, state, error, now).await?;
        self.ended(held, checkpoint).await;
        Ok(held)
    }

    async fn last_checkpoint(&self) -> Result<Option<String>, StoreError> {
        Ok(self.jobs.store.job(&self.job.id).await?.and_then(|job| job.checkpoint))
    }

    /// A job that has ended resumes no more: its checkpoint goes once the end is durable.
    async fn ended(&self, held: Held, checkpoint: Option<String>) {
        if let (Held::Yes, Some(key)) = (held, checkpoint) {
            self.jobs.store.artifacts().remove(&key).await;
        }
        self.jobs.announce();
    }

    /// Gives the job back to the queue; `blameless` when the attempt should not count against it.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn release(&self, blameless: bool) -> Result<Held, StoreError> {
        let now = self.jobs.now_ms();
        let held = self.jobs.store.release_job(&self.job.id, &self.token, blameless, now).await?;
        self.jobs.announce();
        Ok(held)
    }

    /// Attempts without a new checkpoint, this one included, have used up the policy's patience.
    pub fn is_last_chance(&self) -> bool {
        self.job.idle_attempts >= i64::from(self.jobs.policy.max_idle_attempts)
    }

    /// The queue this lease belongs to.
    pub fn jobs(&self) -> &Jobs {
        &self.jobs
    }
}
