//! Operations of the exporter: claim an export, record progress, publish the file, or record a failure.

use std::fs::File;
use std::path::{Path, PathBuf};

use crate::store::exports::{ClaimedExport, EXPORTS, ExportedFile};
use crate::store::hash::hash_file;
use crate::store::{Store, StoreError, sql};
use relume_api::ExportId;

impl Store {
    /// Claims the next queued export: of frames if `frames`, otherwise of the other kinds. The tenant whose last export ended
    /// longest ago is served first.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn claim_export(&self, frames: bool, now_ms: i64) -> Result<Option<ClaimedExport>, StoreError> {
        let mut tx = self.write().await?;
        let claimed = sql::query_as(
            "UPDATE exports SET state = 'running', started_ms = COALESCE(started_ms, $1)
             WHERE state = 'queued' AND id = (
                 SELECT id FROM exports AS next
                 WHERE state = 'queued' AND deleted_ms IS NULL AND (kind = 'frames') = $2
                 ORDER BY (SELECT COALESCE(MAX(finished_ms), 0) FROM exports WHERE tenant = next.tenant), created_ms, id
                 LIMIT 1)
             RETURNING *",
        )
        .bind(now_ms)
        .bind(frames)
        .fetch_optional(&mut tx)
        .await?;
        tx.commit().await?;
        Ok(claimed)
    }

    /// Returns exports to the queue that a terminated server had claimed: `only` this one, or all. The caller must hold the lock
    /// of the data directory.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn requeue_exports(&self, only: Option<&ExportId>) -> Result<u64, StoreError> {
        let mut tx = self.write().await?;
        let query = "UPDATE exports SET state = 'queued' WHERE state = 'running' AND ($1 IS NULL OR id = $1)";
        let changed = sql::query(query).bind(only).execute(&mut tx).await?;
        tx.commit().await?;
        Ok(changed)
    }

    /// Records that `done` frames with `work_bytes` bytes in total are complete. Returns `false` if the export was cancelled or
    /// deleted.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn record_export_progress(
        &self,
        id: &ExportId,
        done: i64,
        work_bytes: u64,
    ) -> Result<bool, StoreError> {
        let mut tx = self.write().await?;
        let query = "UPDATE exports SET done = CASE WHEN total < $2 THEN total ELSE $2 END, work_bytes = $3
                         WHERE id = $1 AND state = 'running' AND deleted_ms IS NULL";
        let bytes = i64::try_from(work_bytes).unwrap_or(i64::MAX);
        let changed = sql::query(query).bind(id).bind(done).bind(bytes).execute(&mut tx).await?;
        tx.commit().await?;
        Ok(changed == 1)
    }

    /// Publishes a file as the result of an export and clears the size of its work folder. Returns `false` and removes the file
    /// if the export was cancelled or deleted.
    ///
    /// # Errors
    /// When the file cannot be moved or the database fails. The next start then removes the file.
    pub async fn publish_export(
        &self,
        id: &ExportId,
        file: ExportedFile,
        now_ms: i64,
    ) -> Result<bool, StoreError> {
        let key = format!("{EXPORTS}/{id}");
        self.artifacts.upload_file(&file.path, &key).await?;
        let (from, to) = (file.path, self.artifacts.local_path(&key));
        let _publish_guard = self.publish_lock.lock().await;
        let moved = tokio::task::spawn_blocking(move || move_durably(&from, &to)).await;
        let (sha256, bytes) = moved.map_err(std::io::Error::other)??;
        self.artifacts.add_to_cache(&key, bytes);
        let mut tx = self.write().await?;
        let changed = sql::query(
            "UPDATE exports SET state = 'succeeded', done = total, work_bytes = 0, file_name = $2, content_type = $3,
                 artifact = $4, bytes = $5, sha256 = $6, finished_ms = $7
             WHERE id = $1 AND state = 'running' AND deleted_ms IS NULL",
        )
        .bind(id)
        .bind(&file.name)
        .bind(file.content_type)
        .bind(&key)
        .bind(i64::try_from(bytes).unwrap_or(i64::MAX))
        .bind(sha256)
        .bind(now_ms)
        .execute(&mut tx)
        .await?;
        tx.commit().await?;
        if changed == 0 {
            self.artifacts.discard(&key).await?;
        }
        Ok(changed == 1)
    }

    /// Ends an export as failed.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn fail_export(
        &self,
        id: &ExportId,
        code: &str,
        detail: &str,
        now_ms: i64,
    ) -> Result<(), StoreError> {
        let mut tx = self.write().await?;
        let query = "UPDATE exports SET state = 'failed', work_bytes = 0, error_code = $2, error_detail = $3, finished_ms = $4
                         WHERE id = $1 AND state = 'running'";
        sql::query(query).bind(id).bind(code).bind(detail).bind(now_ms).execute(&mut tx).await?;
        Ok(tx.commit().await?)
    }

    /// The work folder of an export. It is created when it is first needed.
    pub fn export_folder(&self, id: &ExportId) -> PathBuf {
        self.root.join(EXPORTS).join(id.as_str())
    }
}

/// Moves a file within the data directory and returns its hash and size. The move is durable on return. Blocks.
fn move_durably(from: &Path, to: &Path) -> std::io::Result<(String, u64)> {
    let mut file = File::open(from)?;
    let (sha256, bytes) = (hash_file(&mut file)?, file.metadata()?.len());
    file.sync_all()?;
    let folder = to.parent().unwrap_or(to);
    std::fs::create_dir_all(folder)?;
    std::fs::rename(from, to)?;
    File::open(folder)?.sync_all()?;
    Ok((sha256, bytes))
}
