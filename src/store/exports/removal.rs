//! Cancellation and deletion of exports: on request, with their model, or by age; and removal of their files.

use std::collections::HashSet;
use std::time::Duration;

use crate::store::artifacts::is_key;
use crate::store::exports::{EXPORTS, ExportRecord, columns};
use crate::store::sql::{self, Tx};
use crate::store::{Store, StoreError};
use relume_api::{ExportId, TenantId};

/// Result of a request to delete an export.
#[derive(Debug, Clone)]
pub enum ExportDeletion {
    /// The export was queued or running and is now cancelled.
    Cancelled(Box<ExportRecord>),
    /// The export had ended and is now deleted.
    Deleted,
    /// The export does not exist.
    NotFound,
}

impl Store {
    /// Cancels a queued or running export; deletes an export that has ended.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn delete_export(
        &self,
        tenant: &TenantId,
        id: &ExportId,
        now_ms: i64,
    ) -> Result<ExportDeletion, StoreError> {
        let mut tx = self.write().await?;
        let cancel = concat!(
            "UPDATE exports SET state = 'cancelled', work_bytes = 0, finished_ms = $3
             WHERE id = $1 AND tenant = $2 AND state IN ('queued', 'running') AND deleted_ms IS NULL RETURNING ",
            columns!()
        );
        let cancelled: Option<ExportRecord> =
            sql::query_as(cancel).bind(id).bind(tenant).bind(now_ms).fetch_optional(&mut tx).await?;
        if let Some(export) = cancelled {
            tx.commit().await?;
            return Ok(ExportDeletion::Cancelled(Box::new(export)));
        }
        let delete = "UPDATE exports SET deleted_ms = $3, work_bytes = 0
                          WHERE id = $1 AND tenant = $2 AND deleted_ms IS NULL";
        let deleted = sql::query(delete).bind(id).bind(tenant).bind(now_ms).execute(&mut tx).await?;
        tx.commit().await?;
        Ok(if deleted == 1 { ExportDeletion::Deleted } else { ExportDeletion::NotFound })
    }

    /// Deletes at most `most` exports that ended longer ago than `keep`. Returns their number.
    pub(in crate::store) async fn expire_exports(
        &self,
        keep: Duration,
        most: usize,
        now_ms: i64,
    ) -> Result<usize, StoreError> {
        let before = now_ms.saturating_sub(i64::try_from(keep.as_millis()).unwrap_or(i64::MAX));
        let mut tx = self.write().await?;
        let query = "UPDATE exports SET deleted_ms = $2 WHERE id IN (SELECT id FROM exports
             WHERE deleted_ms IS NULL AND finished_ms < $1 ORDER BY finished_ms LIMIT $3)";
        let most = i64::try_from(most).unwrap_or(i64::MAX);
        let deleted = sql::query(query).bind(before).bind(now_ms).bind(most).execute(&mut tx).await?;
        tx.commit().await?;
        Ok(usize::try_from(deleted).unwrap_or(usize::MAX))
    }

    /// Removes the files and rows of deleted exports. Returns their number.
    pub(in crate::store) async fn discard_exports(&self) -> Result<usize, StoreError> {
        let query = "SELECT id, artifact FROM exports WHERE deleted_ms IS NOT NULL";
        let exports: Vec<(ExportId, Option<String>)> = sql::query_as(query).fetch_all(self.pool()).await?;
        for (id, artifact) in &exports {
            if let Some(artifact) = artifact {
                self.artifacts.discard(artifact).await?;
            }
            self.clear_folder(id.as_str()).await?;
            let mut tx = self.write().await?;
            sql::query("DELETE FROM exports WHERE id = $1").bind(id).execute(&mut tx).await?;
            tx.commit().await?;
            tracing::info!(export = %id, "removed the files of a deleted export");
        }
        Ok(exports.len())
    }

    /// Removes the work folders of all exports that are neither queued nor running.
    ///
    /// # Errors
    /// When the database or the file system fails.
    pub async fn clear_export_folders(&self) -> Result<(), StoreError> {
        let mut found = Vec::new();
        let mut entries = match tokio::fs::read_dir(self.root.join(EXPORTS)).await {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
            entries => entries?,
        };
        while let Some(entry) = entries.next_entry().await? {
            found.extend(entry.file_name().into_string());
        }
        // Queried after the folder was read, so that exports that began since are included.
        let query = "SELECT id FROM exports WHERE state IN ('queued', 'running') AND deleted_ms IS NULL";
        let wanted: Vec<String> = sql::query_scalar(query).fetch_all(self.pool()).await?;
        let wanted: HashSet<String> = wanted.into_iter().collect();
        for name in found.iter().filter(|name| !wanted.contains(*name)) {
            self.clear_folder(name).await?;
        }
        Ok(())
    }

    async fn clear_folder(&self, name: &str) -> Result<(), StoreError> {
        if !is_key(name) {
            return Err(StoreError::Damaged(format!("{EXPORTS}/{name}")));
        }
        match tokio::fs::remove_dir_all(self.root.join(EXPORTS).join(name)).await {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error.into()),
            _ => Ok(()),
        }
    }
}

/// Deletes the exports of a model, in the transaction that deletes it.
pub(in crate::store) async fn delete_exports_of(
    tx: &mut Tx,
    model: &str,
    now_ms: i64,
) -> Result<(), StoreError> {
    let query =
        "UPDATE exports SET deleted_ms = $2, work_bytes = 0 WHERE model_id = $1 AND deleted_ms IS NULL";
    sql::query(query).bind(model).bind(now_ms).execute(&mut *tx).await?;
    Ok(())
}
