//! Resumable uploads, which arrive in chunks over several requests and server processes. The database records the number of
//! received bytes after the bytes are on disk.

mod finalise;
mod piece;
mod record;
mod upload_locks;
mod validating;

use std::path::Path;

use sqlx::types::Json;

use crate::store::sql::{self, Tx};
use crate::store::uploads::record::key;
use crate::store::{Page, Store, StoreError};
use relume_api::{TenantId, UploadId};

pub use piece::{Checksum, Piece};
pub(super) use record::UPLOADS;
pub use record::{UploadLimits, UploadRecord};
pub use upload_locks::{UploadLock, UploadLocks};

impl Store {
    /// Creates an upload; a tenant may have `most`.
    ///
    /// # Errors
    /// [`StoreError::UploadQuotaExceeded`] beyond `most`; [`StoreError::ByteQuotaExceeded`] and
    /// [`StoreError::StorageLimitExceeded`] if the complete upload would exceed a limit. When the database or the file system
    /// fails.
    pub async fn begin_upload(&self, upload: &UploadRecord, most: u32) -> Result<(), StoreError> {
        self.admit_bytes_of(&upload.tenant, upload.total()).await?;
        self.admit_bytes(upload.total()).await?;
        let mut tx = self.write().await?;
        self.admit_upload_of(&mut tx, upload, most).await?;
        // The file is created first. If its row is missing, the next start removes the file.
        let path = self.artifacts.local_path(&upload.key());
        tokio::task::spawn_blocking(move || make_file(&path)).await.map_err(std::io::Error::other)??;
        self.insert_upload(&mut tx, upload).await?;
        Ok(tx.commit().await?)
    }

    /// Refuses another upload of a tenant that has `most`.
    async fn admit_upload_of(&self, tx: &mut Tx, upload: &UploadRecord, most: u32) -> Result<(), StoreError> {
        let counting = "SELECT COUNT(*) FROM uploads WHERE tenant = $1 AND expires_ms > $2";
        let count: i64 = sql::query_scalar(counting)
            .bind(&upload.tenant)
            .bind(upload.created_ms)
            .fetch_one(&mut *tx)
            .await?;
        if count >= i64::from(most) { Err(StoreError::UploadQuotaExceeded { most }) } else { Ok(()) }
    }

    async fn insert_upload(&self, tx: &mut Tx, upload: &UploadRecord) -> Result<(), StoreError> {
        sql::query(
            "INSERT INTO uploads
                 (id, tenant, length, received, metadata, created_ms, expires_ms, capture_id, sha256, name, external_id,
                  labels)
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12)",
        )
        .bind(&upload.id)
        .bind(&upload.tenant)
        .bind(upload.length)
        .bind(upload.received)
        .bind(&upload.metadata)
        .bind(upload.created_ms)
        .bind(upload.expires_ms)
        .bind(&upload.capture_id)
        .bind(&upload.sha256)
        .bind(&upload.capture_metadata.name)
        .bind(&upload.capture_metadata.external_id)
        .bind(Json(&upload.capture_metadata.labels))
        .execute(&mut *tx)
        .await?;
        Ok(())
    }

    /// An upload of a tenant, expired or not.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn upload(&self, tenant: &TenantId, id: &UploadId) -> Result<Option<UploadRecord>, StoreError> {
        let query =
            sql::query_as("SELECT * FROM uploads WHERE id = $1 AND tenant = $2").bind(id).bind(tenant);
        Ok(query.fetch_optional(self.pool()).await?)
    }

    /// Uploads of a tenant that have not expired, newest first.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn uploads(
        &self,
        tenant: &TenantId,
        now_ms: i64,
        page: &Page,
    ) -> Result<Vec<UploadRecord>, StoreError> {
        let query = sql::query_as(
            "SELECT * FROM uploads WHERE tenant = $1 AND expires_ms > $2
               AND ($3 IS NULL OR (created_ms, id) < ($5, $3))
             ORDER BY created_ms DESC, id DESC LIMIT $4",
        );
        let query =
            query.bind(tenant).bind(now_ms).bind(page.id()).bind(i64::from(page.limit)).bind(page.at());
        Ok(query.fetch_all(self.pool()).await?)
    }

    /// Whether an upload exists.
    pub(super) async fn has_upload(&self, id: &UploadId) -> Result<bool, StoreError> {
        let query = sql::query_scalar("SELECT EXISTS (SELECT 1 FROM uploads WHERE id = $1)").bind(id);
        Ok(query.fetch_one(self.pool()).await?)
    }

    /// Locks an upload; `None` if it is already locked.
    pub fn lock_upload(&self, id: &UploadId) -> Option<UploadLock> {
        self.upload_locks.take(id)
    }

    /// Deletes an upload. If the server terminates before the file is removed, the next start removes it.
    ///
    /// # Errors
    /// When the database or the file system fails.
    pub async fn drop_upload(&self, lock: &UploadLock) -> Result<(), StoreError> {
        let mut tx = self.write().await?;
        sql::query("DELETE FROM uploads WHERE id = $1").bind(lock.id()).execute(&mut tx).await?;
        tx.commit().await?;
        self.artifacts.discard(&key(lock.id())).await
    }

    /// Deletes expired uploads that are not locked. Returns their number.
    ///
    /// # Errors
    /// When the database or the file system fails. The next run continues.
    pub async fn expire_uploads(&self, now_ms: i64) -> Result<usize, StoreError> {
        let query = "SELECT id FROM uploads WHERE expires_ms <= $1
                         AND (capture_id IS NULL OR problem IS NOT NULL) ORDER BY expires_ms LIMIT 1000";
        let ids: Vec<UploadId> = sql::query_scalar(query).bind(now_ms).fetch_all(self.pool()).await?;
        let mut dropped = 0;
        for id in ids {
            let Some(lock) = self.lock_upload(&id) else { continue };
            // A chunk may have arrived in the meantime.
            let query = "SELECT expires_ms FROM uploads WHERE id = $1";
            let expires: Option<i64> = sql::query_scalar(query).bind(&id).fetch_optional(self.pool()).await?;
            if expires.is_some_and(|at| at <= now_ms) {
                self.drop_upload(&lock).await?;
                tracing::info!(upload = %id, "deleted an expired upload");
                dropped += 1;
            }
        }
        Ok(dropped)
    }

    /// Makes files and rows consistent after an unclean shutdown: truncates files to the recorded size, and deletes uploads whose
    /// bytes are missing. The caller must hold the lock of the data directory.
    ///
    /// # Errors
    /// When the database or the file system fails.
    pub async fn recover_uploads(&self) -> Result<(), StoreError> {
        let uploads: Vec<UploadRecord> =
            sql::query_as("SELECT * FROM uploads").fetch_all(self.pool()).await?;
        for upload in uploads {
            let path = self.artifacts.local_path(&upload.key());
            let found = match std::fs::metadata(&path) {
                Ok(file) => Some(file.len()),
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => None,
                Err(error) => return Err(error.into()),
            };
            match found {
                Some(length) if length == upload.offset() => {}
                Some(length) if length > upload.offset() => {
                    std::fs::File::options().write(true).open(&path)?.set_len(upload.offset())?;
                }
                _ => {
                    tracing::warn!(upload = %upload.id, "deleted an upload whose bytes are missing");
                    if let Some(lock) = self.lock_upload(&upload.id) {
                        self.drop_upload(&lock).await?;
                    }
                }
            }
        }
        Ok(())
    }
}

/// Creates an empty file and its folder. Both are durable on return. Blocks.
fn make_file(path: &Path) -> std::io::Result<()> {
    let folder = path.parent().unwrap_or(path);
    std::fs::create_dir_all(folder)?;
    std::fs::File::create_new(path)?.sync_all()?;
    for folder in folder.ancestors().take(2) {
        std::fs::File::open(folder)?.sync_all()?;
    }
    Ok(())
}
