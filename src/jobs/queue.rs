//! Operations of clients on jobs, and the reclaiming of expired leases.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;

use crate::jobs::changes::JobChanges;
use crate::jobs::clock::{Clock, Ids};
use crate::store::{
    CancelOutcome, EventRecord, Filter, IdempotencyKey, JobRecord, MAX_QUEUE_POSITION, Page, Store,
    StoreError, Submitted,
};
use relume_api::jobs::{JobState, NewJob};
use relume_api::{JobId, TenantId};

/// Time between two attempts to listen for changes by other servers.
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// Parameters of leases.
#[derive(Debug, Clone, Copy)]
pub struct LeasePolicy {
    /// Duration of a lease without a heartbeat.
    pub duration: Duration,
    /// Maximum number of attempts without a new checkpoint before a job fails.
    pub max_idle_attempts: u32,
    /// Time without a heartbeat after which a worker's jobs are given to others.
    pub heartbeat_timeout: Duration,
}

impl Default for LeasePolicy {
    fn default() -> Self {
        // Heartbeats follow only steps, and there are none during the import of a large capture.
        Self {
            duration: Duration::from_secs(600),
            max_idle_attempts: 5,
            heartbeat_timeout: Duration::from_secs(60),
        }
    }
}

/// The origin of a job.
#[derive(Debug, Clone, Default)]
pub struct Origin {
    /// The job that it retries.
    pub retry_of: Option<JobId>,
    /// The trace of the request that created it, as a W3C `traceparent`.
    pub traceparent: Option<String>,
}

/// The job queue.
#[derive(Clone)]
pub struct Jobs {
    pub(super) store: Store,
    clock: Arc<dyn Clock>,
    ids: Arc<dyn Ids>,
    pub(super) policy: LeasePolicy,
    changes: Arc<JobChanges>,
}

impl Jobs {
    /// A queue on `store`.
    pub fn new(store: Store, clock: Arc<dyn Clock>, ids: Arc<dyn Ids>, policy: LeasePolicy) -> Self {
        Self { store, clock, ids, policy, changes: Arc::new(JobChanges::new()) }
    }

    /// The store.
    pub fn store(&self) -> &Store {
        &self.store
    }

    /// The current time, milliseconds since 1970 UTC.
    pub fn now_ms(&self) -> i64 {
        self.clock.now_ms()
    }

    /// Sets the clock to the time of the shared database.
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

    /// Notifies when any job may have changed; the change is in the store.
    pub fn subscribe(&self) -> watch::Receiver<()> {
        self.changes.subscribe()
    }

    /// Notifies when one job may have changed; the change is in the store.
    pub fn subscribe_to(&self, job: &JobId) -> watch::Receiver<()> {
        self.changes.subscribe_to(job)
    }

    /// Notifies subscribers of changes by other servers that share the database. Never returns. While the database cannot be
    /// reached, subscribers query it periodically.
    pub async fn listen_for_changes(&self) {
        loop {
            if let Err(error) = self.forward_changes().await {
                tracing::warn!(%error, "cannot listen for changes of jobs by other servers at present");
            }
            tokio::time::sleep(RETRY_INTERVAL).await;
        }
    }

    async fn forward_changes(&self) -> Result<(), StoreError> {
        let mut listener = self.store.listen().await?;
        loop {
            match listener.wait_for_change().await? {
                Some(job) => self.announce(&job),
                None => self.announce_all(),
            }
        }
    }

    /// Queues a job of `total` steps for a tenant; see [`Store::submit_job`].
    ///
    /// # Errors
    /// [`StoreError::IdempotencyKeyReused`] if the key was used with another request.
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
        self.announce(&job.id);
        Ok(submitted)
    }

    /// A job of a tenant and, while it is queued, the number of jobs before it.
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

    /// The number of jobs before each of the queued jobs, at most [`MAX_QUEUE_POSITION`].
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

    /// Whether any job is queued.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn has_queued_jobs(&self) -> Result<bool, StoreError> {
        Ok(self.store.job_counts().await?.iter().any(|(state, _)| *state == JobState::Queued))
    }

    /// Cancels a queued job immediately; asks a running job to stop.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn cancel(&self, tenant: &TenantId, id: &JobId) -> Result<CancelOutcome, StoreError> {
        let outcome = self.store.cancel_job(tenant, id, self.now_ms()).await?;
        if let CancelOutcome::Accepted(job) = &outcome {
            self.drop_checkpoint(job).await;
        }
        self.announce(id);
        Ok(outcome)
    }

    /// Changes the priority of a queued job; `false` if it is not queued.
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

    /// Reclaims expired leases, and the leases of workers without recent heartbeats.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn reclaim_expired(&self) -> Result<Vec<JobRecord>, StoreError> {
        self.reclaim(self.now_ms()).await
    }

    /// Also reclaims the leases of all workers that are not registered. The caller must hold the lock of the data directory and
    /// must have removed the earlier local workers of this server; then all these workers are dead.
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
            tracing::info!(job = %job.id, state = job.state.name(), "reclaimed a lease");
            self.drop_checkpoint(job).await;
            self.announce(&job.id);
        }
        Ok(jobs)
    }

    /// Removes the checkpoint of a job that has ended. If the server terminates before, the next startup cleanup removes it.
    async fn drop_checkpoint(&self, job: &JobRecord) {
        if let (true, Some(key)) = (job.state.is_terminal(), &job.checkpoint) {
            self.store.artifacts().remove(key).await;
        }
    }

    pub(super) fn lease_end(&self, now_ms: i64) -> i64 {
        now_ms.saturating_add(i64::try_from(self.policy.duration.as_millis()).unwrap_or(i64::MAX))
    }

    pub(super) fn announce(&self, job: &JobId) {
        self.changes.announce(job);
    }

    pub(super) fn announce_all(&self) {
        self.changes.announce_all();
    }
}
