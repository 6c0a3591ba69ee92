//! The worker registry, with the last heartbeat of each worker.

use sqlx::FromRow;
use sqlx::types::Json;

use crate::store::{Store, StoreError, rfc3339, sql};
use relume_api::work::{WorkerHello, WorkerState, WorkerView};
use relume_api::{JobId, WorkerId};

/// A worker.
#[derive(Debug, Clone, FromRow)]
pub struct WorkerRecord {
    /// Identifier.
    pub id: WorkerId,
    /// The data directory of the server of a local worker; `None` for a remote worker.
    pub server: Option<String>,
    /// Descriptive name.
    pub name: String,
    /// The device.
    pub device: String,
    /// Whether the device is a GPU.
    pub has_gpu: bool,
    /// Its labels, which jobs can require.
    #[sqlx(json)]
    pub labels: Vec<String>,
    /// Version of its program.
    pub version: String,
    /// Whether it gets no more jobs.
    pub draining: bool,
    /// Time of the first heartbeat.
    pub started_ms: i64,
    /// Time of the last heartbeat.
    pub seen_ms: i64,
    /// The job that it runs.
    pub job: Option<JobId>,
}

impl WorkerRecord {
    /// The worker as the API shows it. It is lost if its last heartbeat is before `heartbeat_cutoff_ms`.
    pub fn view(self, heartbeat_cutoff_ms: i64) -> WorkerView {
        let state = match (self.seen_ms < heartbeat_cutoff_ms, self.draining, &self.job) {
            (true, _, _) => WorkerState::Lost,
            (false, true, _) => WorkerState::Draining,
            (false, false, Some(_)) => WorkerState::Working,
            (false, false, None) => WorkerState::Idle,
        };
        WorkerView {
            id: self.id,
            name: self.name,
            in_server: self.server.is_some(),
            device: self.device,
            has_gpu: self.has_gpu,
            labels: self.labels,
            version: self.version,
            state,
            draining: self.draining,
            job: self.job,
            started_at: rfc3339(self.started_ms),
            seen_at: rfc3339(self.seen_ms),
        }
    }
}

/// All columns, and the job.
macro_rules! workers {
    () => {
        "SELECT *, (SELECT MIN(jobs.id) FROM jobs
                    WHERE jobs.worker = workers.id AND jobs.state IN ('running', 'cancelling')) AS job FROM workers"
    };
}

impl Store {
    /// Registers a worker or records its heartbeat. Returns whether the worker is draining.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn record_worker_heartbeat(
        &self,
        hello: &WorkerHello,
        server: Option<&str>,
        now_ms: i64,
    ) -> Result<bool, StoreError> {
        let mut tx = self.write_row().await?;
        let query = sql::query_scalar(
            "INSERT INTO workers (id, server, name, device, has_gpu, labels, version, started_ms, seen_ms)
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $8)
             ON CONFLICT (id) DO UPDATE SET name = $3, device = $4, has_gpu = $5, labels = $6, version = $7, seen_ms = $8
             RETURNING draining",
        );
        let query =
            query.bind(&hello.id).bind(server).bind(&hello.name).bind(&hello.device).bind(hello.has_gpu);
        let query = query.bind(Json(&hello.labels)).bind(&hello.version).bind(now_ms);
        let draining = query.fetch_one(&mut tx).await?;
        tx.commit().await?;
        Ok(draining)
    }

    /// Records a heartbeat of a worker that runs a job.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn record_lease_heartbeat(
        &self,
        job: &JobId,
        token: &str,
        now_ms: i64,
    ) -> Result<(), StoreError> {
        let mut tx = self.write_row().await?;
        let query = "UPDATE workers SET seen_ms = $3
             WHERE id = (SELECT worker FROM jobs WHERE id = $1 AND lease_token = $2)";
        sql::query(query).bind(job).bind(token).bind(now_ms).execute(&mut tx).await?;
        Ok(tx.commit().await?)
    }

    /// Sets the heartbeat of every worker to `now_ms`, because no heartbeats arrived while the server was stopped.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn reset_heartbeats(&self, now_ms: i64) -> Result<(), StoreError> {
        let mut tx = self.write().await?;
        sql::query("UPDATE workers SET seen_ms = $1").bind(now_ms).execute(&mut tx).await?;
        Ok(tx.commit().await?)
    }

    /// Removes the local workers of the server of a data directory, and all workers without a heartbeat since `seen_ms`.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn remove_workers(&self, server: Option<&str>, seen_ms: i64) -> Result<(), StoreError> {
        let mut tx = self.write().await?;
        let query = sql::query("DELETE FROM workers WHERE server = $1 OR seen_ms < $2");
        query.bind(server).bind(seen_ms).execute(&mut tx).await?;
        Ok(tx.commit().await?)
    }

    /// All workers, by name.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn workers(&self) -> Result<Vec<WorkerRecord>, StoreError> {
        Ok(sql::query_as(concat!(workers!(), " ORDER BY name, id")).fetch_all(self.pool()).await?)
    }

    /// A worker.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn worker(&self, id: &WorkerId) -> Result<Option<WorkerRecord>, StoreError> {
        let query = sql::query_as(concat!(workers!(), " WHERE id = $1")).bind(id);
        Ok(query.fetch_optional(self.pool()).await?)
    }

    /// Sets whether a worker gets no more jobs; `false` if the worker does not exist.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn set_draining(&self, id: &WorkerId, draining: bool) -> Result<bool, StoreError> {
        let mut tx = self.write_row().await?;
        let query = sql::query("UPDATE workers SET draining = $2 WHERE id = $1").bind(id).bind(draining);
        let done = query.execute(&mut tx).await?;
        tx.commit().await?;
        Ok(done == 1)
    }

    /// Whether a worker with a heartbeat since `seen_ms` has a GPU.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn has_gpu_worker(&self, seen_ms: i64) -> Result<bool, StoreError> {
        let query = sql::query_scalar("SELECT COUNT(*) FROM workers WHERE has_gpu AND seen_ms >= $1");
        let count: i64 = query.bind(seen_ms).fetch_one(self.pool()).await?;
        Ok(count > 0)
    }

    /// The submission time of the job that has been queued longest, milliseconds since 1970 UTC.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn oldest_queued(&self) -> Result<Option<i64>, StoreError> {
        let query = sql::query_scalar("SELECT MIN(created_ms) FROM jobs WHERE state = 'queued'");
        Ok(query.fetch_one(self.pool()).await?)
    }
}
