//! What clients of the service do to jobs, and what is done about leases that ran out.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;

use crate::jobs::clock::{Clock, Ids};
use crate::store::{
    CancelOutcome, EventRecord, Filter, IdempotencyKey, JobRecord, MAX_QUEUE_POSITION, Page, Store,
    StoreError, Submitted,
};
use relume_api::jobs::{JobState, NewJob};
use relume_api::{JobId, TenantId};

/// Time between two attempts to hear of what others write.
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// How leases behave.
#[derive(Debug, Clone, Copy)]
pub struct LeasePolicy {
    /// How long a claim lasts without a heartbeat.
    pub duration: Duration,
    /// Attempts without a new checkpoint before a job is given up.
    pub max_idle_attempts: u32,
    /// How long a worker may be silent before its jobs are given to others.
    pub heartbeat_timeout: Duration,
}

impl Default for LeasePolicy {
    fn default() -> Self {
        // Heartbeats follow steps only, and there is none while a large capture is imported.
        Self {
            duration: Duration::from_secs(600),
            max_idle_attempts: 5,
            heartbeat_timeout: Duration::from_secs(60),
        }
    }
}

/// Where a job comes from.
#[derive(Debug, Clone, Default)]
pub struct Origin {
    /// The job that it repeats.
    pub retry_of: Option<JobId>,
    /// The trace of the request that made it, as a W3C `traceparent`.
    pub traceparent: Option<String>,
}

/// The job queue.
#[derive(Clone)]
pub struct Jobs {
    pub(super) store: Store,
    clock: Arc<dyn Clock>,
    ids: Arc<dyn Ids>,
    pub(super) policy: LeasePolicy,
    changes: Arc<watch::Sender<()>>,
}

impl Jobs {
    /// A queue on `store`.
    pub fn new(store: Store, clock: Arc<dyn Clock>, ids: Arc<dyn Ids>, policy: LeasePolicy) -> Self {
        Self { store, clock, ids, policy, changes: Arc::new(watch::Sender::new(())) }
    }

    /// The store beneath.
    pub fn store(&self) -> &Store {
        &self.store
    }

    /// The current time, milliseconds since 1970 UTC.
    pub fn now_ms(&self) -> i64 {
        self.clock.now_ms()
    }

    /// Follows the time of a database that others share.
    ///
    /// # Errors
    /// When the database does not answer.
    pub async fn sync_clock(&self) -> Result<(), StoreError> {
        if let Some(now_ms) = self.store.database_time().await? {
            self.clock.set(now_ms);
        }
        Ok(())
    }

    /// A fresh identifier.
    pub fn fresh_id<I: From<String>>(&self) -> I {
        self.ids.fresh().into()
    }

    /// Wakes when some job may have changed; what changed is in the store.
    pub fn subscribe(&self) -> watch::Receiver<()> {
        self.changes.subscribe()
    }

    /// Wakes subscribers also when somebody else who shares the database has written about a job. Never ends; while the database
    /// cannot be reached, everybody looks at it by themselves.
    pub async fn listen_for_changes(&self) {
        loop {
            if let Err(error) = self.forward_changes().await {
                tracing::warn!(%error, "changes by others are not heard of for now");
            }
            tokio::time::sleep(RETRY_INTERVAL).await;
        }
    }

    async fn forward_changes(&self) -> Result<(), StoreError> {
        let mut listener = self.store.listen().await?;
        loop {
            listener.wait_for_change().await?;
            self.announce();
        }
    }

    /// Queues a job of `total` steps for a tenant; see [`Store::submit_job`].
    ///
    /// # Errors
    /// [`StoreError::IdempotencyKeyReused`] when the key came with another request before.
    pub async fn submit(
        &self,
        tenant: &TenantId,
        request: NewJob,
        total: i64,
        origin: Origin,
        key: Option<&IdempotencyKey>,
        answer: impl FnOnce(&JobRecord, Option<i64>) -> String + Send,
    ) -> Result<Submitted, StoreError> {
        let id = self.fresh_id();
        let job = JobRecord::queued(tenant.clone(), id, request, total, self.now_ms());
        let Origin { retry_of, traceparent } = origin;
        let job = JobRecord { retry_of, traceparent, ..job };
        let submitted = self.store.submit_job(&job, key, answer).await?;
        self.announce();
        Ok(submitted)
    }

    /// A job of a tenant and, while it waits, how many run before it.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn get(
        &self,
        tenant: &TenantId,
        id: &JobId,
    ) -> Result<Option<(JobRecord, Option<i64>)>, StoreError> {
        let Some(job) = self.store.job(tenant, id).await? else { return Ok(None) };
        let position = match job.state {
            JobState::Queued => self.store.queue_position(id).await?,
            _ => None,
        };
        Ok(Some((job, position)))
    }

    /// Jobs of a tenant, newest first.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn list(
        &self,
        tenant: &TenantId,
        state: Option<JobState>,
        filter: &Filter,
        page: &Page,
    ) -> Result<Vec<JobRecord>, StoreError> {
        self.store.jobs(tenant, state, filter, page).await
    }

    /// How many jobs run before each of these that waits, at most [`MAX_QUEUE_POSITION`].
    ///
    /// # Errors
    /// When the database fails.
    pub async fn positions(&self, jobs: &[JobRecord]) -> Result<HashMap<JobId, i64>, StoreError> {
        let waiting = jobs.iter().filter(|job| job.state == JobState::Queued);
        let waiting: Vec<JobId> = waiting.map(|job| job.id.clone()).collect();
        if waiting.is_empty() {
            return Ok(HashMap::new());
        }
        let head = self.store.head_of_queue().await?;
        let place = |id: &JobId| head.get(id).copied().unwrap_or(MAX_QUEUE_POSITION);
        Ok(waiting.into_iter().map(|id| (id.clone(), place(&id))).collect())
    }

    /// True when some job waits for a worker.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn has_queued_jobs(&self) -> Result<bool, StoreError> {
        Ok(self.store.job_counts().await?.iter().any(|(state, _)| *state == JobState::Queued))
    }

    /// Cancels a queued job at once, asks a running one to stop.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn cancel(&self, tenant: &TenantId, id: &JobId) -> Result<CancelOutcome, StoreError> {
        let outcome = self.store.cancel_job(tenant, id, self.now_ms()).await?;
        if let CancelOutcome::Accepted(job) = &outcome {
            self.drop_checkpoint(job).await;
        }
        self.announce();
        Ok(outcome)
    }

    /// Changes the priority of a job that waits; `false` when it does not wait.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn set_priority(
        &self,
        tenant: &TenantId,
        id: &JobId,
        priority: i64,
    ) -> Result<bool, StoreError> {
        self.store.set_priority(tenant, id, priority).await
    }

    /// Events of a job after number `after`, oldest first.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn events_after(
        &self,
        tenant: &TenantId,
        id: &JobId,
        after: i64,
    ) -> Result<Vec<EventRecord>, StoreError> {
        self.store.events_after(tenant, id, after).await
    }

    /// Takes back leases that ran out, and those of workers that have been silent for too long.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn reclaim_expired(&self) -> Result<Vec<JobRecord>, StoreError> {
        self.reclaim(self.now_ms()).await
    }

    /// Takes back also every lease whose worker is not registered. The caller must hold the node lock and have forgotten the workers
    /// that were threads of this server before: then all of these are dead.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn reclaim_all(&self) -> Result<Vec<JobRecord>, StoreError> {
        self.reclaim(i64::MAX).await
    }

    async fn reclaim(&self, expired_ms: i64) -> Result<Vec<JobRecord>, StoreError> {
        let max_idle = i64::from(self.policy.max_idle_attempts);
        let (now, alive) = (self.now_ms(), self.heartbeat_cutoff_ms());
        let jobs = self.store.reclaim_leases((expired_ms, alive), max_idle, now).await?;
        for job in &jobs {
            tracing::info!(job = %job.id, state = job.state.name(), "took a lease back");
            self.drop_checkpoint(job).await;
        }
        if !jobs.is_empty() {
            self.announce();
        }
        Ok(jobs)
    }

    /// Removes the checkpoint of a job that has ended. Should the server die before, the next start sweeps it away.
    async fn drop_checkpoint(&self, job: &JobRecord) {
        if let (true, Some(key)) = (job.state.is_terminal(), &job.checkpoint) {
            self.store.artifacts().remove(key).await;
        }
    }

    pub(super) fn lease_end(&self, now_ms: i64) -> i64 {
        now_ms.saturating_add(i64::try_from(self.policy.duration.as_millis()).unwrap_or(i64::MAX))
    }

    pub(super) fn announce(&self) {
        self.changes.send_replace(());
    }
}
