//! Removes the files of deleted resources, then deletes the rows that nothing refers to. The server can terminate after any step;
//! the next run continues.

use std::collections::HashSet;

use crate::store::artifacts::is_key;
use crate::store::orphan_cleanup::prune;
use crate::store::{Store, StoreError, sql};

/// Result of a garbage collection of deleted resources.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DeletionReport {
    /// Resources whose files were removed.
    pub things: usize,
    /// Resources whose files are still in use.
    pub waiting: usize,
}

impl Store {
    /// Removes the files of deleted resources, unless another row references the same file or a job still reads it.
    ///
    /// # Errors
    /// When the database or a file operation fails. The next run continues.
    pub async fn remove_deleted_files(&self, now_ms: i64) -> Result<DeletionReport, StoreError> {
        self.discard_replaced(now_ms).await?;
        let things = self.discard_exports().await?
            + self.discard_models().await?
            + self.discard_jobs(now_ms).await?
            + self.discard_captures(now_ms).await?
            + self.discard_environments().await?;
        if things > 0 {
            self.purge_deleted().await?;
        }
        let waiting: i64 = sql::query_scalar(
            "SELECT (SELECT COUNT(*) FROM jobs WHERE deleted_ms IS NOT NULL AND swept_ms IS NULL)
                  + (SELECT COUNT(*) FROM captures WHERE deleted_ms IS NOT NULL AND swept_ms IS NULL)
                  + (SELECT COUNT(*) FROM environments WHERE deleted_ms IS NOT NULL)",
        )
        .fetch_one(self.pool())
        .await?;
        Ok(DeletionReport { things, waiting: usize::try_from(waiting).unwrap_or(0) })
    }

    /// As [`Store::remove_deleted_files`], and also completes the deletions of a terminated server.
    ///
    /// # Errors
    /// See [`Store::remove_deleted_files`].
    pub async fn finish_deletions(&self, now_ms: i64) -> Result<(), StoreError> {
        self.remove_deleted_files(now_ms).await?;
        self.purge_deleted().await
    }

    /// Deletes the rows of deleted resources whose files are removed, if no other row refers to them.
    async fn purge_deleted(&self) -> Result<(), StoreError> {
        let mut tx = self.write().await?;
        // A job may be the retry of another deleted job.
        while sql::query(
            "DELETE FROM jobs WHERE swept_ms IS NOT NULL
                 AND NOT EXISTS (SELECT 1 FROM models WHERE models.job_id = jobs.id)
                 AND NOT EXISTS (SELECT 1 FROM jobs AS later WHERE later.retry_of = jobs.id)",
        )
        .execute(&mut tx)
        .await?
            > 0
        {}
        sql::query(
            "DELETE FROM captures WHERE swept_ms IS NOT NULL
                 AND NOT EXISTS (SELECT 1 FROM jobs WHERE jobs.capture_id = captures.id)
                 AND NOT EXISTS (SELECT 1 FROM models WHERE models.capture_id = captures.id)",
        )
        .execute(&mut tx)
        .await?;
        Ok(tx.commit().await?)
    }

    async fn discard_models(&self) -> Result<usize, StoreError> {
        let query = "SELECT id, job_id FROM models WHERE deleted_ms IS NOT NULL";
        let models: Vec<(String, String)> = sql::query_as(query).fetch_all(self.pool()).await?;
        for (model, job) in &models {
            let query = "SELECT artifact FROM model_files WHERE model_id = $1";
            let files: Vec<String> = sql::query_scalar(query).bind(model).fetch_all(self.pool()).await?;
            let parts = files.clone();
            self.remove_of_job(job, files).await?;
            for file in parts {
                self.prune_folder_of(&file).await?;
            }
            let mut tx = self.write().await?;
            for delete in ["DELETE FROM model_files WHERE model_id = $1", "DELETE FROM models WHERE id = $1"]
            {
                sql::query(delete).bind(model).execute(&mut tx).await?;
            }
            tx.commit().await?;
            tracing::info!(model, "removed the files of a deleted model");
        }
        Ok(models.len())
    }

    /// Jobs that have ended: removes all files of their attempts except the files of their model.
    async fn discard_jobs(&self, now_ms: i64) -> Result<usize, StoreError> {
        let query = "SELECT id FROM jobs WHERE deleted_ms IS NOT NULL AND swept_ms IS NULL
                         AND state IN ('succeeded', 'rejected', 'failed', 'cancelled')";
        let jobs: Vec<String> = sql::query_scalar(query).fetch_all(self.pool()).await?;
        for job in &jobs {
            if !is_key(job) {
                return Err(StoreError::Damaged(format!("attempts/{job}")));
            }
            let query =
                "SELECT artifact FROM model_files JOIN models ON models.id = model_id WHERE job_id = $1";
            let kept: Vec<String> = sql::query_scalar(query).bind(job).fetch_all(self.pool()).await?;
            let kept: HashSet<String> = kept.into_iter().collect();
            let stored = self.artifacts.of_job(job).await?;
            self.remove_of_job(job, stored.into_iter().filter(|key| !kept.contains(key)).collect()).await?;
            let mut tx = self.write().await?;
            let history = "DELETE FROM events WHERE job_id = $1";
            sql::query(history).bind(job).execute(&mut tx).await?;
            let swept = "UPDATE jobs SET swept_ms = $2, checkpoint = NULL WHERE id = $1";
            sql::query(swept).bind(job).bind(now_ms).execute(&mut tx).await?;
            tx.commit().await?;
            tracing::info!(job, "removed the files of a deleted job");
        }
        Ok(jobs.len())
    }

    async fn discard_captures(&self, now_ms: i64) -> Result<usize, StoreError> {
        let query = "SELECT id, artifact FROM captures
             WHERE deleted_ms IS NOT NULL AND swept_ms IS NULL AND NOT EXISTS
                 (SELECT 1 FROM jobs WHERE capture_id = captures.id AND state IN ('queued', 'running', 'cancelling'))";
        let captures: Vec<(String, String)> = sql::query_as(query).fetch_all(self.pool()).await?;
        for (capture, artifact) in &captures {
            let _publish_guard = self.publish_lock.lock().await;
            let others = "SELECT EXISTS
                 (SELECT 1 FROM captures WHERE artifact = $1 AND id <> $2 AND swept_ms IS NULL)";
            if !sql::query_scalar(others).bind(artifact).bind(capture).fetch_one(self.pool()).await? {
                self.artifacts.discard(artifact).await?;
            }
            let mut tx = self.write().await?;
            let swept = "UPDATE captures SET swept_ms = $2 WHERE id = $1";
            sql::query(swept).bind(capture).bind(now_ms).execute(&mut tx).await?;
            tx.commit().await?;
            tracing::info!(capture, "removed the file of a deleted capture");
        }
        Ok(captures.len())
    }

    async fn discard_environments(&self) -> Result<usize, StoreError> {
        let query = "SELECT id, artifact FROM environments
             WHERE deleted_ms IS NOT NULL AND NOT EXISTS
                 (SELECT 1 FROM jobs WHERE overrides -> 'light' ->> 'environment' = environments.id
                      AND state IN ('queued', 'running', 'cancelling'))";
        let environments: Vec<(String, String)> = sql::query_as(query).fetch_all(self.pool()).await?;
        for (environment, artifact) in &environments {
            let _publish_guard = self.publish_lock.lock().await;
            let others = "SELECT EXISTS (SELECT 1 FROM environments WHERE artifact = $1 AND id <> $2)";
            if !sql::query_scalar(others).bind(artifact).bind(environment).fetch_one(self.pool()).await? {
                self.artifacts.discard(artifact).await?;
            }
            let mut tx = self.write().await?;
            let forget = "DELETE FROM environments WHERE id = $1";
            sql::query(forget).bind(environment).execute(&mut tx).await?;
            tx.commit().await?;
            tracing::info!(environment, "removed the file of a deleted environment");
        }
        Ok(environments.len())
    }

    /// Removes files that attempts of a job wrote, and folders that are then empty.
    async fn remove_of_job(&self, job: &str, files: Vec<String>) -> Result<(), StoreError> {
        let folder = format!("attempts/{job}");
        if !is_key(&folder) {
            return Err(StoreError::Damaged(folder));
        }
        for file in files {
            self.artifacts.discard(&file).await?;
        }
        let folder = self.artifacts.local_path(&folder);
        Ok(tokio::task::spawn_blocking(move || prune(&folder)).await.map_err(std::io::Error::other)??)
    }
}
