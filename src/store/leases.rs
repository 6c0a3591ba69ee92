//! Operations of workers on jobs. Every write carries the lease token; if it changes no row, the lease is lost.

use serde_json::json;
use sqlx::types::Json;

use crate::store::sql::{self, Sql, Tx};
use crate::store::{JobRecord, ModelFile, ModelRecord, QualityResult, Store, StoreError, events, preemption};
use relume_api::jobs::{JobProgress, JobState};
use relume_api::work::{LeaseStatus, Release};
use relume_api::{JobId, WorkerId};

/// The worker that claims a job.
#[derive(Debug, Clone, Default)]
pub struct Claimant {
    /// The worker; `None` if it is not registered.
    pub worker: Option<WorkerId>,
    /// Whether it has a GPU.
    pub has_gpu: bool,
    /// Its labels.
    pub labels: Vec<String>,
}

/// The status of a lease on a job in `state`.
fn status_of(state: Option<JobState>) -> LeaseStatus {
    match state {
        Some(JobState::Running) => LeaseStatus::Held,
        Some(JobState::Cancelling) => LeaseStatus::Cancelling,
        _ => LeaseStatus::Lost,
    }
}

impl Store {
    /// Assigns the next queued job that the worker can run, with a fresh token, in one statement.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn claim_job(
        &self,
        claimant: &Claimant,
        token: &str,
        now_ms: i64,
        until_ms: i64,
    ) -> Result<Option<JobRecord>, StoreError> {
        let mut tx = self.write_row().await?;
        let query = sql::query_as(CLAIM).bind(token).bind(now_ms).bind(until_ms);
        let query = query.bind(&claimant.worker).bind(claimant.has_gpu).bind(Json(&claimant.labels));
        let job: Option<JobRecord> = query.fetch_optional(&mut tx).await?;
        if let Some(job) = &job {
            let data = json!({ "state": job.state, "attempt": job.attempts });
            events::append_state(&mut tx, &job.id, now_ms, job.state, data).await?;
        }
        tx.commit().await?;
        Ok(job)
    }

    /// The job, of any tenant, that is leased with `token`.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn leased_job(&self, job: &JobId, token: &str) -> Result<Option<JobRecord>, StoreError> {
        let query = sql::query_as(
            "SELECT * FROM jobs WHERE id = $1 AND lease_token = $2 AND state IN ('running', 'cancelling')",
        );
        Ok(query.bind(job).bind(token).fetch_optional(self.pool()).await?)
    }

    /// Whether `token` still holds the lease of the job. Changes nothing.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn lease_status(&self, job: &JobId, token: &str) -> Result<LeaseStatus, StoreError> {
        let query = sql::query_scalar("SELECT state FROM jobs WHERE id = $1 AND lease_token = $2");
        let state: Option<JobState> = query.bind(job).bind(token).fetch_optional(self.pool()).await?;
        Ok(status_of(state))
    }

    /// Records progress with an event and renews the lease.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn record_progress(
        &self,
        job: &JobId,
        token: &str,
        progress: &JobProgress,
        now_ms: i64,
        until_ms: i64,
    ) -> Result<LeaseStatus, StoreError> {
        let mut tx = self.write_row().await?;
        let state: Option<JobState> = sql::query_scalar(
            "UPDATE jobs SET lease_until_ms = $3, step = $4, total = $5, loss = $6, psnr = $7,
                 gaussians = $8, eta_seconds = $9, message = $10
             WHERE id = $1 AND lease_token = $2 AND state IN ('running', 'cancelling') RETURNING state",
        )
        .bind(job)
        .bind(token)
        .bind(until_ms)
        .bind(progress.step)
        .bind(progress.total)
        .bind(progress.loss)
        .bind(progress.psnr)
        .bind(progress.gaussians)
        .bind(progress.eta_seconds)
        .bind(&progress.message)
        .fetch_optional(&mut tx)
        .await?;
        if state.is_some() {
            events::append(&mut tx, job, now_ms, "progress", json!(progress)).await?;
            tx.commit().await?;
        }
        Ok(status_of(state))
    }

    /// Records a warning for the user, unless the lease is lost.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn record_warning(
        &self,
        job: &JobId,
        token: &str,
        message: &str,
        now_ms: i64,
    ) -> Result<LeaseStatus, StoreError> {
        let mut tx = self.write_row().await?;
        // This update locks the row, so that the lease cannot be lost before the warning is recorded.
        let query = "UPDATE jobs SET lease_token = $2 WHERE id = $1 AND lease_token = $2 RETURNING state";
        let state: Option<JobState> =
            sql::query_scalar(query).bind(job).bind(token).fetch_optional(&mut tx).await?;
        let status = status_of(state);
        if status != LeaseStatus::Lost {
            events::append(&mut tx, job, now_ms, "warning", json!({ "message": message })).await?;
            tx.commit().await?;
        }
        Ok(status)
    }

    /// Records a checkpoint that is already in the artifact store. Returns the key of the checkpoint that it replaces.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn record_checkpoint(
        &self,
        job: &JobId,
        token: &str,
        (artifact, sha256): (&str, &str),
        step: i64,
        now_ms: i64,
    ) -> Result<(LeaseStatus, Option<String>), StoreError> {
        let mut tx = self.write_row().await?;
        let query = sql::query_scalar("SELECT checkpoint FROM jobs WHERE id = $1");
        let previous: Option<Option<String>> = query.bind(job).fetch_optional(&mut tx).await?;
        let state: Option<JobState> = sql::query_scalar(
            "UPDATE jobs SET checkpoint = $3, checkpoint_step = $4, checkpoint_sha256 = $5, idle_attempts = 0
             WHERE id = $1 AND lease_token = $2 AND state IN ('running', 'cancelling') RETURNING state",
        )
        .bind(job)
        .bind(token)
        .bind(artifact)
        .bind(step)
        .bind(sha256)
        .fetch_optional(&mut tx)
        .await?;
        if state.is_none() {
            return Ok((LeaseStatus::Lost, None));
        }
        events::append(&mut tx, job, now_ms, "checkpoint", json!({ "step": step })).await?;
        tx.commit().await?;
        Ok((status_of(state), previous.flatten().filter(|key| key != artifact)))
    }

    /// Publishes the model and ends the job as succeeded or rejected, in one transaction.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn publish_model(
        &self,
        token: &str,
        model: &ModelRecord,
        files: &[ModelFile],
        measured: &QualityResult,
        now_ms: i64,
    ) -> Result<LeaseStatus, StoreError> {
        let mut tx = self.write().await?;
        let done = sql::query(
            "UPDATE jobs SET state = $5, figures = $6, finished_ms = $3, model_id = $4, step = total,
                 eta_seconds = NULL, message = NULL, checkpoint = NULL, lease_token = NULL, lease_until_ms = NULL
             WHERE id = $1 AND lease_token = $2 AND state = 'running'",
        )
        .bind(&model.job_id)
        .bind(token)
        .bind(now_ms)
        .bind(&model.id)
        .bind(measured.state())
        .bind(Json(&measured.figures))
        .execute(&mut tx)
        .await?;
        if done == 0 {
            drop(tx);
            return match self.lease_status(&model.job_id, token).await? {
                LeaseStatus::Cancelling => Ok(LeaseStatus::Cancelling),
                LeaseStatus::Held | LeaseStatus::Lost => Ok(LeaseStatus::Lost),
            };
        }
        insert_model(&mut tx, model, files).await?;
        let (state, data) = (measured.state(), measured.event(&model.id));
        events::append_state(&mut tx, &model.job_id, now_ms, state, data).await?;
        tx.commit().await?;
        Ok(LeaseStatus::Held)
    }

    /// Ends a job: as `Cancelled`, or as `Failed` with a stable code and a reason.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn end_job(
        &self,
        job: &JobId,
        token: &str,
        state: JobState,
        error: Option<(&str, &str)>,
        now_ms: i64,
    ) -> Result<LeaseStatus, StoreError> {
        let mut tx = self.write().await?;
        let (code, detail) = error.unzip();
        let done = sql::query(
            "UPDATE jobs SET state = $3, finished_ms = $4, error_code = $5, error_detail = $6,
                 eta_seconds = NULL, message = NULL, checkpoint = NULL, lease_token = NULL, lease_until_ms = NULL
             WHERE id = $1 AND lease_token = $2 AND state IN ('running', 'cancelling')",
        )
        .bind(job)
        .bind(token)
        .bind(state)
        .bind(now_ms)
        .bind(code)
        .bind(detail)
        .execute(&mut tx)
        .await?;
        if done == 0 {
            return Ok(LeaseStatus::Lost);
        }
        let data = json!({ "state": state, "code": code, "detail": detail });
        events::append_state(&mut tx, job, now_ms, state, data).await?;
        tx.commit().await?;
        Ok(LeaseStatus::Held)
    }

    /// Returns a job to the queue.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn release_job(
        &self,
        job: &JobId,
        token: &str,
        release: Release,
        now_ms: i64,
    ) -> Result<LeaseStatus, StoreError> {
        let waits = release == Release::NoRoom;
        let mut tx = self.write().await?;
        if release == Release::Preempted {
            preemption::move_behind_others(&mut tx, job, token).await?;
        }
        let step: Option<i64> = sql::query_scalar(
            "UPDATE jobs SET state = 'queued', lease_token = NULL, lease_until_ms = NULL,
                 eta_seconds = NULL, idle_attempts = CASE WHEN idle_attempts < $3 THEN 0 ELSE idle_attempts - $3 END,
                 step = CASE WHEN $4 THEN COALESCE(checkpoint_step, 0) ELSE step END,
                 message = CASE WHEN $4 THEN 'waiting for disk space' WHEN $5 THEN 'paused: other jobs run first'
                                ELSE message END
             WHERE id = $1 AND lease_token = $2 AND state = 'running' RETURNING step",
        )
        .bind(job)
        .bind(token)
        .bind(i64::from(release != Release::AttemptFailed))
        .bind(waits)
        .bind(release == Release::Preempted)
        .fetch_optional(&mut tx)
        .await?;
        let Some(step) = step else { return Ok(LeaseStatus::Lost) };
        if waits {
            let message =
                format!("the disk is full; the job waits for disk space and continues from step {step}");
            events::append(&mut tx, job, now_ms, "warning", json!({ "message": message })).await?;
        }
        let queued = json!({ "state": JobState::Queued });
        events::append_state(&mut tx, job, now_ms, JobState::Queued, queued).await?;
        tx.commit().await?;
        Ok(LeaseStatus::Held)
    }

    /// Reclaims leases. For registered workers: leases that ended before `now_ms`, and leases of workers without a heartbeat
    /// since `seen_ms`. For other workers: leases that ended before `expired_ms`.
    ///
    /// A running job is returned to the queue, or fails with `attempts_exhausted` after `max_idle` attempts without a checkpoint;
    /// a job in the state `cancelling` is cancelled. Returns the changed jobs.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn reclaim_leases(
        &self,
        (expired_ms, seen_ms): (i64, i64),
        max_idle: i64,
        now_ms: i64,
    ) -> Result<Vec<JobRecord>, StoreError> {
        let mut tx = self.write().await?;
        let jobs: Vec<JobRecord> = sql::query_as(
            "UPDATE jobs SET
                 state = CASE WHEN state = 'cancelling' THEN 'cancelled'
                              WHEN idle_attempts >= $2 THEN 'failed' ELSE 'queued' END,
                 finished_ms = CASE WHEN state = 'cancelling' OR idle_attempts >= $2 THEN $3 END,
                 error_code = CASE WHEN state = 'running' AND idle_attempts >= $2
                                   THEN 'attempts_exhausted' END,
                 error_detail = CASE WHEN state = 'running' AND idle_attempts >= $2 THEN
                     'the worker died ' || idle_attempts || ' times without reaching a new checkpoint' END,
                 eta_seconds = NULL, lease_token = NULL, lease_until_ms = NULL
             WHERE state IN ('running', 'cancelling')
               AND CASE WHEN worker IS NULL THEN lease_until_ms < $1
                        ELSE lease_until_ms < $3 OR NOT EXISTS
                            (SELECT 1 FROM workers WHERE workers.id = jobs.worker AND workers.seen_ms >= $4) END
             RETURNING *",
        )
        .bind(expired_ms)
        .bind(max_idle)
        .bind(now_ms)
        .bind(seen_ms)
        .fetch_all(&mut tx)
        .await?;
        for job in &jobs {
            let data = json!({ "state": job.state, "code": job.error_code, "detail": job.error_detail });
            events::append_state(&mut tx, &job.id, now_ms, job.state, data).await?;
        }
        tx.commit().await?;
        Ok(jobs)
    }
}

/// Assigns the next queued job. On PostgreSQL a job that another server is assigning at the same time is skipped.
const CLAIM: Sql = {
    macro_rules! claim {
        ($has_all:literal, $lock:literal) => {
            concat!(
                "UPDATE jobs SET state = 'running', lease_token = $1, lease_until_ms = $3, worker = $4,
                     attempts = attempts + 1, idle_attempts = idle_attempts + 1,
                     started_ms = COALESCE(started_ms, $2)
                 WHERE id = (SELECT id FROM jobs AS waiting WHERE state = 'queued' AND (device <> 'gpu' OR $5)
                     AND NOT EXISTS (SELECT 1 FROM workers WHERE workers.id = $4 AND draining) AND ",
                $has_all,
                " ORDER BY priority DESC, turn, created_ms, id LIMIT 1",
                $lock,
                ") RETURNING *"
            )
        };
    }
    Sql::each(
        claim!(
            "NOT EXISTS (SELECT 1 FROM json_each(waiting.requires) AS wanted
                         WHERE wanted.value NOT IN (SELECT value FROM json_each($6)))",
            ""
        ),
        claim!("requires <@ $6", " FOR UPDATE SKIP LOCKED"),
    )
};

async fn insert_model(tx: &mut Tx, model: &ModelRecord, files: &[ModelFile]) -> Result<(), StoreError> {
    sql::query(
        "INSERT INTO models (id, job_id, capture_id, gaussians, card, created_ms, tenant, name, external_id, labels)
         SELECT $1, id, $3, $4, $5, $6, tenant, name, external_id, labels FROM jobs WHERE id = $2",
    )
    .bind(&model.id)
    .bind(&model.job_id)
    .bind(&model.capture_id)
    .bind(model.gaussians)
    .bind(Json(&model.card))
    .bind(model.created_ms)
    .execute(&mut *tx)
    .await?;
    for file in files {
        sql::query(
            "INSERT INTO model_files (model_id, name, content_type, bytes, sha256, artifact)
             VALUES ($1, $2, $3, $4, $5, $6)",
        )
        .bind(&model.id)
        .bind(&file.name)
        .bind(&file.content_type)
        .bind(file.bytes)
        .bind(&file.sha256)
        .bind(&file.artifact)
        .execute(&mut *tx)
        .await?;
    }
    Ok(())
}
