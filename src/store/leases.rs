//! Jobs as workers see them. Every write carries the lease token; zero rows changed means that the lease is lost.

use serde_json::json;
use sqlx::{Sqlite, Transaction};

use crate::store::{JobRecord, JobState, ModelFile, ModelRecord, ProgressUpdate, Store, StoreError, events};

/// What a worker's write found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Held {
    /// The lease stands.
    Yes,
    /// The lease stands and the job was asked to stop.
    Cancelling,
    /// Someone else has the job: stop and publish nothing.
    Lost,
}

impl Store {
    /// Gives the next queued job to a worker under a fresh token, in one statement.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn claim_job(
        &self,
        token: &str,
        now_ms: i64,
        until_ms: i64,
    ) -> Result<Option<JobRecord>, StoreError> {
        let mut tx = self.write().await?;
        let job: Option<JobRecord> = sqlx::query_as(
            "UPDATE jobs SET state = 'running', lease_token = ?1, lease_until_ms = ?3,
                 attempts = attempts + 1, idle_attempts = idle_attempts + 1,
                 started_ms = COALESCE(started_ms, ?2)
             WHERE id = (SELECT id FROM jobs WHERE state = 'queued'
                         ORDER BY priority DESC, created_ms, id LIMIT 1)
             RETURNING *",
        )
        .bind(token)
        .bind(now_ms)
        .bind(until_ms)
        .fetch_optional(&mut *tx)
        .await?;
        if let Some(job) = &job {
            let data = json!({ "state": job.state, "attempt": job.attempts });
            events::append(&mut tx, &job.id, now_ms, "state", data).await?;
        }
        tx.commit().await?;
        Ok(job)
    }

    /// Whether `token` still holds the job. Changes nothing.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn held(&self, job: &str, token: &str) -> Result<Held, StoreError> {
        let query = sqlx::query_scalar("SELECT state FROM jobs WHERE id = ?1 AND lease_token = ?2");
        let state: Option<JobState> = query.bind(job).bind(token).fetch_optional(&self.pool).await?;
        Ok(match state {
            Some(JobState::Running) => Held::Yes,
            Some(JobState::Cancelling) => Held::Cancelling,
            _ => Held::Lost,
        })
    }

    /// Records progress, extends the lease and tells listeners.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn record_progress(
        &self,
        job: &str,
        token: &str,
        progress: &ProgressUpdate,
        now_ms: i64,
        until_ms: i64,
    ) -> Result<Held, StoreError> {
        let mut tx = self.write().await?;
        let state: Option<JobState> = sqlx::query_scalar(
            "UPDATE jobs SET lease_until_ms = ?3, step = ?4, total = ?5, loss = ?6, psnr = ?7,
                 gaussians = ?8, eta_seconds = ?9, message = ?10
             WHERE id = ?1 AND lease_token = ?2 AND state IN ('running', 'cancelling') RETURNING state",
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
        .fetch_optional(&mut *tx)
        .await?;
        let Some(state) = state else { return Ok(Held::Lost) };
        events::append(&mut tx, job, now_ms, "progress", json!(progress)).await?;
        tx.commit().await?;
        Ok(if state == JobState::Running { Held::Yes } else { Held::Cancelling })
    }

    /// Tells listeners something a user should know.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn record_warning(&self, job: &str, message: &str, now_ms: i64) -> Result<(), StoreError> {
        let mut tx = self.write().await?;
        events::append(&mut tx, job, now_ms, "warning", json!({ "message": message })).await?;
        Ok(tx.commit().await?)
    }

    /// Points the job at a checkpoint that is in the artifact store already. Returns the one it replaces.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn record_checkpoint(
        &self,
        job: &str,
        token: &str,
        artifact: &str,
        step: i64,
        now_ms: i64,
    ) -> Result<(Held, Option<String>), StoreError> {
        let mut tx = self.write().await?;
        let query = sqlx::query_scalar("SELECT checkpoint FROM jobs WHERE id = ?1");
        let previous: Option<Option<String>> = query.bind(job).fetch_optional(&mut *tx).await?;
        let state: Option<JobState> = sqlx::query_scalar(
            "UPDATE jobs SET checkpoint = ?3, checkpoint_step = ?4, idle_attempts = 0
             WHERE id = ?1 AND lease_token = ?2 AND state IN ('running', 'cancelling') RETURNING state",
        )
        .bind(job)
        .bind(token)
        .bind(artifact)
        .bind(step)
        .fetch_optional(&mut *tx)
        .await?;
        let Some(state) = state else { return Ok((Held::Lost, None)) };
        events::append(&mut tx, job, now_ms, "checkpoint", json!({ "step": step })).await?;
        tx.commit().await?;
        let held = if state == JobState::Running { Held::Yes } else { Held::Cancelling };
        Ok((held, previous.flatten().filter(|key| key != artifact)))
    }

    /// Publishes the model and ends the job, in one transaction: both happen or neither.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn publish_model(
        &self,
        token: &str,
        model: &ModelRecord,
        files: &[ModelFile],
        now_ms: i64,
    ) -> Result<Held, StoreError> {
        let mut tx = self.write().await?;
        let done = sqlx::query(
            "UPDATE jobs SET state = 'succeeded', finished_ms = ?3, model_id = ?4, step = total,
                 eta_seconds = NULL, message = NULL, checkpoint = NULL, lease_token = NULL, lease_until_ms = NULL
             WHERE id = ?1 AND lease_token = ?2 AND state = 'running'",
        )
        .bind(&model.job_id)
        .bind(token)
        .bind(now_ms)
        .bind(&model.id)
        .execute(&mut *tx)
        .await?;
        if done.rows_affected() == 0 {
            drop(tx);
            return match self.held(&model.job_id, token).await? {
                Held::Cancelling => Ok(Held::Cancelling),
                Held::Yes | Held::Lost => Ok(Held::Lost),
            };
        }
        insert_model(&mut tx, model, files).await?;
        let data = json!({ "state": JobState::Succeeded, "model": model.id });
        events::append(&mut tx, &model.job_id, now_ms, "state", data).await?;
        tx.commit().await?;
        Ok(Held::Yes)
    }

    /// Ends a job for good: `Cancelled`, or `Failed` with a stable code and a reason.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn end_job(
        &self,
        job: &str,
        token: &str,
        state: JobState,
        error: Option<(&str, &str)>,
        now_ms: i64,
    ) -> Result<Held, StoreError> {
        let mut tx = self.write().await?;
        let (code, detail) = error.unzip();
        let done = sqlx::query(
            "UPDATE jobs SET state = ?3, finished_ms = ?4, error_code = ?5, error_detail = ?6,
                 eta_seconds = NULL, message = NULL, checkpoint = NULL, lease_token = NULL, lease_until_ms = NULL
             WHERE id = ?1 AND lease_token = ?2 AND state IN ('running', 'cancelling')",
        )
        .bind(job)
        .bind(token)
        .bind(state)
        .bind(now_ms)
        .bind(code)
        .bind(detail)
        .execute(&mut *tx)
        .await?;
        if done.rows_affected() == 0 {
            return Ok(Held::Lost);
        }
        let data = json!({ "state": state, "code": code, "detail": detail });
        events::append(&mut tx, job, now_ms, "state", data).await?;
        tx.commit().await?;
        Ok(Held::Yes)
    }

    /// Gives a job back to the queue. `blameless` when the job did nothing wrong, e.g. at a shutdown: the attempt
    /// then does not count against it.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn release_job(
        &self,
        job: &str,
        token: &str,
        blameless: bool,
        now_ms: i64,
    ) -> Result<Held, StoreError> {
        let mut tx = self.write().await?;
        let done = sqlx::query(
            "UPDATE jobs SET state = 'queued', lease_token = NULL, lease_until_ms = NULL,
                 eta_seconds = NULL, idle_attempts = MAX(0, idle_attempts - ?3)
             WHERE id = ?1 AND lease_token = ?2 AND state = 'running'",
        )
        .bind(job)
        .bind(token)
        .bind(i64::from(blameless))
        .execute(&mut *tx)
        .await?;
        if done.rows_affected() == 0 {
            return Ok(Held::Lost);
        }
        events::append(&mut tx, job, now_ms, "state", json!({ "state": JobState::Queued })).await?;
        tx.commit().await?;
        Ok(Held::Yes)
    }

    /// Takes leases back: those that ran out before `expired_ms`, or every one when it is `i64::MAX`.
    ///
    /// A running job goes back to the queue, or fails with `attempts_exhausted` after `max_idle` attempts without
    /// a checkpoint; one that was cancelling is cancelled. Returns the jobs touched.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn reclaim_leases(
        &self,
        expired_ms: i64,
        max_idle: i64,
        now_ms: i64,
    ) -> Result<Vec<JobRecord>, StoreError> {
        let mut tx = self.write().await?;
        let jobs: Vec<JobRecord> = sqlx::query_as(
            "UPDATE jobs SET
                 state = CASE WHEN state = 'cancelling' THEN 'cancelled'
                              WHEN idle_attempts >= ?2 THEN 'failed' ELSE 'queued' END,
                 finished_ms = CASE WHEN state = 'cancelling' OR idle_attempts >= ?2 THEN ?3 END,
                 error_code = CASE WHEN state = 'running' AND idle_attempts >= ?2
                                   THEN 'attempts_exhausted' END,
                 error_detail = CASE WHEN state = 'running' AND idle_attempts >= ?2 THEN
                     'the worker died ' || idle_attempts || ' times without reaching a new checkpoint' END,
                 eta_seconds = NULL, lease_token = NULL, lease_until_ms = NULL
             WHERE state IN ('running', 'cancelling') AND lease_until_ms < ?1 RETURNING *",
        )
        .bind(expired_ms)
        .bind(max_idle)
        .bind(now_ms)
        .fetch_all(&mut *tx)
        .await?;
        for job in &jobs {
            let data = json!({ "state": job.state, "code": job.error_code, "detail": job.error_detail });
            events::append(&mut tx, &job.id, now_ms, "state", data).await?;
        }
        tx.commit().await?;
        Ok(jobs)
    }
}

async fn insert_model(
    tx: &mut Transaction<'_, Sqlite>,
    model: &ModelRecord,
    files: &[ModelFile],
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT INTO models (id, job_id, capture_id, gaussians, card, created_ms)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6)",
    )
    .bind(&model.id)
    .bind(&model.job_id)
    .bind(&model.capture_id)
    .bind(model.gaussians)
    .bind(&model.card)
    .bind(model.created_ms)
    .execute(&mut **tx)
    .await?;
    for file in files {
        sqlx::query(
            "INSERT INTO model_files (model_id, name, content_type, bytes, sha256, artifact)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6)",
        )
        .bind(&model.id)
        .bind(&file.name)
        .bind(&file.content_type)
        .bind(file.bytes)
        .bind(&file.sha256)
        .bind(&file.artifact)
        .execute(&mut **tx)
        .await?;
    }
    Ok(())
}
