//! Operations of clients on jobs: submit, read, cancel, change the priority.

use std::collections::HashMap;

use serde_json::json;
use sqlx::types::Json;

use crate::store::deletion::check_not_deleted;
use crate::store::idempotency::{remember, replay};
use crate::store::metadata::{filtered, listed};
use crate::store::sql::{self, Tx};
use crate::store::{Filter, IdempotencyKey, JobRecord, Page, Store, StoreError, events};
use relume_api::jobs::JobState;
use relume_api::{JobId, TenantId};

/// The turn of a tenant's next job with a priority, as SQL. Jobs of one priority run in the order of their turns. The jobs of a tenant
/// have successive turns; the first one has the turn of the head of the queue. So tenants take turns, however many jobs each has
/// (start-time fair queueing: Goyal, Vin and Cheng 1996).
macro_rules! turn {
    ($priority:literal, $tenant:literal) => {
        concat!(
            "COALESCE(
                 (SELECT MAX(turn) + 1 FROM jobs WHERE state IN ('queued', 'running') AND tenant = ",
            $tenant,
            " AND priority = ",
            $priority,
            "), (SELECT MIN(turn) FROM jobs WHERE state = 'queued' AND priority = ",
            $priority,
            "), (SELECT MAX(turn) FROM jobs WHERE state = 'running' AND priority = ",
            $priority,
            "), 0)"
        )
    };
}

/// Result of a submission.
#[derive(Debug, Clone)]
pub enum Submitted {
    /// A job was queued. The text is the answer, which is recorded under the idempotency key, if any.
    Created(String),
    /// The idempotency key was known; this is its recorded answer.
    Replayed(String),
}

/// Result of a request to cancel a job.
#[derive(Debug, Clone)]
pub enum CancelOutcome {
    /// The job is cancelled or will be.
    Accepted(JobRecord),
    /// The job had already ended in another state.
    AlreadyFinished(JobRecord),
    /// The job does not exist.
    NotFound,
}

impl Store {
    /// Queues a job and records the answer under its idempotency key, in one transaction.
    ///
    /// `answer` turns the new job and its position in the queue into the response text.
    ///
    /// # Errors
    /// [`StoreError::IdempotencyKeyReused`] if the key was used with another request.
    pub async fn submit_job(
        &self,
        job: &JobRecord,
        key: Option<&IdempotencyKey>,
        answer: impl FnOnce(&JobRecord, Option<i64>) -> String + Send,
    ) -> Result<Submitted, StoreError> {
        self.admit().await?;
        let (mut tx, now_ms) = (self.write().await?, job.created_ms);
        if let Some(key) = key
            && let Some(response) = replay(&mut tx, &job.tenant, key, now_ms).await?
        {
            tx.commit().await?;
            return Ok(Submitted::Replayed(response));
        }
        check_not_deleted(&mut tx, job).await?;
        self.admit_job_of(&mut tx, &job.tenant).await?;
        insert(&mut tx, job).await?;
        let queued = json!({ "state": JobState::Queued });
        events::append_state(&mut tx, &job.id, now_ms, JobState::Queued, queued).await?;
        let position = sql::query_scalar(POSITION)
            .bind(&job.id)
            .bind(MAX_QUEUE_POSITION)
            .fetch_optional(&mut tx)
            .await?;
        let response = answer(job, position);
        if let Some(key) = key {
            remember(&mut tx, &job.tenant, key, &response, now_ms).await?;
        }
        tx.commit().await?;
        Ok(Submitted::Created(response))
    }

    /// A job of a tenant by identifier.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn job(&self, tenant: &TenantId, id: &JobId) -> Result<Option<JobRecord>, StoreError> {
        let query = sql::query_as("SELECT * FROM jobs WHERE id = $1 AND tenant = $2 AND deleted_ms IS NULL")
            .bind(id)
            .bind(tenant);
        Ok(query.fetch_optional(self.pool()).await?)
    }

    /// Jobs of a tenant that match the filter, newest first, optionally of one state.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn jobs(
        &self,
        tenant: &TenantId,
        state: Option<JobState>,
        filter: &Filter,
        page: &Page,
    ) -> Result<Vec<JobRecord>, StoreError> {
        let query = listed!(
            "jobs",
            "AND tenant = $7 AND deleted_ms IS NULL
               AND ($4 IS NULL OR (created_ms, id) < ($8, $4))
               AND ($5 IS NULL OR state = $5)
             ORDER BY created_ms DESC, id DESC LIMIT $6"
        );
        let query =
            filtered(query, filter).bind(page.id()).bind(state).bind(i64::from(page.limit)).bind(tenant);
        Ok(query.bind(page.at()).fetch_all(self.pool()).await?)
    }

    /// Number of queued jobs of all tenants before this one, at most [`MAX_QUEUE_POSITION`]; `None` if the job is not queued.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn queue_position(&self, id: &JobId) -> Result<Option<i64>, StoreError> {
        Ok(sql::query_scalar(POSITION).bind(id).bind(MAX_QUEUE_POSITION).fetch_optional(self.pool()).await?)
    }

    /// As [`Store::queue_position`], for all queued jobs that have fewer than [`MAX_QUEUE_POSITION`] before them.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn head_of_queue(&self) -> Result<HashMap<JobId, i64>, StoreError> {
        let query = sql::query_as::<(JobId, i64)>(HEAD).bind(MAX_QUEUE_POSITION);
        Ok(query.fetch_all(self.pool()).await?.into_iter().collect())
    }

    /// Number of jobs of all tenants by state, for states with at least one job.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn job_counts(&self) -> Result<Vec<(JobState, i64)>, StoreError> {
        let query = sql::query_as("SELECT state, COUNT(*) FROM jobs WHERE deleted_ms IS NULL GROUP BY state");
        Ok(query.fetch_all(self.pool()).await?)
    }

    /// Cancels a queued job immediately; asks a running job to stop.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn cancel_job(
        &self,
        tenant: &TenantId,
        id: &JobId,
        now_ms: i64,
    ) -> Result<CancelOutcome, StoreError> {
        let mut tx = self.write().await?;
        let changed: Option<JobRecord> = sql::query_as(
            "UPDATE jobs SET
                 state = CASE state WHEN 'queued' THEN 'cancelled' ELSE 'cancelling' END,
                 finished_ms = CASE state WHEN 'queued' THEN $2 END,
                 eta_seconds = NULL
             WHERE id = $1 AND tenant = $3 AND state IN ('queued', 'running') RETURNING *",
        )
        .bind(id)
        .bind(now_ms)
        .bind(tenant)
        .fetch_optional(&mut tx)
        .await?;
        if let Some(job) = changed {
            let data = json!({ "state": job.state });
            events::append_state(&mut tx, id, now_ms, job.state, data).await?;
            tx.commit().await?;
            return Ok(CancelOutcome::Accepted(job));
        }
        drop(tx);
        Ok(match self.job(tenant, id).await? {
            None => CancelOutcome::NotFound,
            Some(job) if job.state.is_terminal() && job.state != JobState::Cancelled => {
                CancelOutcome::AlreadyFinished(job)
            }
            Some(job) => CancelOutcome::Accepted(job),
        })
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
        let mut tx = self.write().await?;
        let query = sql::query(concat!(
            "UPDATE jobs SET priority = $2, turn = CASE WHEN priority = $2 THEN turn ELSE ",
            turn!("$2", "$3"),
            " END WHERE id = $1 AND tenant = $3 AND state = 'queued'"
        ));
        let done = query.bind(id).bind(priority).bind(tenant).execute(&mut tx).await?;
        tx.commit().await?;
        Ok(done == 1)
    }
}

/// Largest queue position that is counted, because counting takes longer for longer queues.
pub const MAX_QUEUE_POSITION: i64 = 1000;

/// The first jobs of the queue, with the number of jobs before each.
macro_rules! head {
    ($most:literal) => {
        concat!(
            "SELECT id, ROW_NUMBER() OVER (ORDER BY priority DESC, turn, created_ms, id) - 1 AS place
             FROM (SELECT id, priority, turn, created_ms FROM jobs WHERE state = 'queued'
                   ORDER BY priority DESC, turn, created_ms, id LIMIT ",
            $most,
            ") AS waiting"
        )
    };
}

const HEAD: &str = head!("$1");

const POSITION: &str = concat!(
    "SELECT COALESCE((SELECT place FROM (",
    head!("$2"),
    ") AS head WHERE head.id = me.id), $2) FROM jobs AS me WHERE me.id = $1 AND me.state = 'queued'"
);

async fn insert(tx: &mut Tx, job: &JobRecord) -> Result<(), StoreError> {
    let query = sql::query(concat!(
        "INSERT INTO jobs
             (id, capture_id, retry_of, preset, overrides, device, priority, total, state, created_ms, tenant,
              quality_gate, name, external_id, labels, requires, traceparent, turn)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15, $16, $17, ",
        turn!("$7", "$11"),
        ")"
    ));
    query
        .bind(&job.id)
        .bind(&job.request.capture)
        .bind(&job.retry_of)
        .bind(job.request.preset)
        .bind(Json(&job.request.overrides))
        .bind(job.request.device)
        .bind(job.request.priority)
        .bind(job.progress.total)
        .bind(job.state)
        .bind(job.created_ms)
        .bind(&job.tenant)
        .bind(Json(&job.request.quality_gate))
        .bind(&job.request.name)
        .bind(&job.request.external_id)
        .bind(Json(&job.request.labels))
        .bind(Json(&job.request.requires))
        .bind(&job.traceparent)
        .execute(&mut *tx)
        .await?;
    Ok(())
}
