//! Uploads whose capture is being validated. They are stored, so that an answer to a client stays valid after a restart.

use std::collections::HashSet;

use sqlx::types::Json;

use crate::store::uploads::record::UploadRecord;
use crate::store::{StagedUpload, Store, StoreError, sql};
use relume_api::metadata::ResourceMetadata;
use relume_api::{CaptureId, Problem, TenantId, UploadId};

impl Store {
    /// Stores a complete body as the resumable upload `upload`, of which a capture is to be made. From then on its bytes are
    /// counted with the upload.
    ///
    /// # Errors
    /// [`StoreError::UploadQuotaExceeded`] if the tenant already has `most`. When the database or the file system fails.
    pub async fn persist_upload(
        &self,
        incoming: &mut StagedUpload,
        upload: &UploadRecord,
        most: u32,
    ) -> Result<(), StoreError> {
        let in_use = || std::io::Error::other("a new upload is already locked");
        let lock = self.lock_upload(&upload.id).ok_or_else(in_use)?;
        let _publish_guard = self.publish_lock.lock().await;
        let mut tx = self.write().await?;
        self.admit_upload_of(&mut tx, upload, most).await?;
        // The file is created first. If its row is missing, the next start removes the file.
        let (from, to) = (incoming.path.clone(), self.artifacts.local_path(&upload.key()));
        let linked = tokio::task::spawn_blocking(move || {
            let folder = to.parent().unwrap_or(&to);
            std::fs::create_dir_all(folder)?;
            std::fs::hard_link(from, &to)?;
            std::fs::File::open(folder)?.sync_all()
        });
        linked.await.map_err(std::io::Error::other)??;
        self.insert_upload(&mut tx, upload).await?;
        tx.commit().await?;
        incoming.reserved.set(0);
        incoming.upload = Some(lock);
        Ok(())
    }

    /// Records that `capture`, with these metadata, is being made of the upload of these bytes.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn begin_validation(
        &self,
        incoming: &StagedUpload,
        capture: &CaptureId,
        metadata: &ResourceMetadata,
    ) -> Result<(), StoreError> {
        let mut tx = self.write().await?;
        let query = "UPDATE uploads SET capture_id = $2, sha256 = $3, problem = NULL,
                         name = $4, external_id = $5, labels = $6 WHERE id = $1";
        sql::query(query)
            .bind(incoming.upload.as_ref().map(|lock| lock.id()))
            .bind(capture)
            .bind(&incoming.sha256)
            .bind(&metadata.name)
            .bind(&metadata.external_id)
            .bind(Json(&metadata.labels))
            .execute(&mut tx)
            .await?;
        Ok(tx.commit().await?)
    }

    /// Records why `capture` could not be made. Its upload is kept until `expires_ms`.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn end_validation(
        &self,
        capture: &CaptureId,
        problem: &Problem,
        expires_ms: i64,
    ) -> Result<(), StoreError> {
        let mut tx = self.write().await?;
        sql::query("UPDATE uploads SET problem = $2, expires_ms = $3 WHERE capture_id = $1")
            .bind(capture)
            .bind(Json(problem))
            .bind(expires_ms)
            .execute(&mut tx)
            .await?;
        Ok(tx.commit().await?)
    }

    /// The upload of which a capture of a tenant is being made, or could not be made.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn upload_of_capture(
        &self,
        tenant: &TenantId,
        capture: &CaptureId,
    ) -> Result<Option<UploadRecord>, StoreError> {
        let query = sql::query_as("SELECT * FROM uploads WHERE capture_id = $1 AND tenant = $2");
        Ok(query.bind(capture).bind(tenant).fetch_optional(self.pool()).await?)
    }

    /// The upload with this content of which a capture of a tenant is being made.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn validating(
        &self,
        tenant: &TenantId,
        sha256: &str,
    ) -> Result<Option<UploadRecord>, StoreError> {
        let query = sql::query_as(
            "SELECT * FROM uploads
             WHERE tenant = $1 AND sha256 = $2 AND capture_id IS NOT NULL AND problem IS NULL LIMIT 1",
        );
        Ok(query.bind(tenant).bind(sha256).fetch_optional(self.pool()).await?)
    }

    /// The uploads of all tenants whose validation has not ended.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn pending_validations(&self) -> Result<Vec<UploadRecord>, StoreError> {
        let query = "SELECT * FROM uploads WHERE capture_id IS NOT NULL AND problem IS NULL
                     ORDER BY created_ms, id";
        Ok(sql::query_as(query).fetch_all(self.pool()).await?)
    }

    /// Counts that a server ended while it validated the capture of an upload. Returns the number of such ends in succession.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn count_interrupted_validation(&self, upload: &UploadId) -> Result<i64, StoreError> {
        let mut tx = self.write().await?;
        let query = "UPDATE uploads SET interrupted_validations = interrupted_validations + 1 WHERE id = $1
                     RETURNING interrupted_validations";
        let count: Option<i64> = sql::query_scalar(query).bind(upload).fetch_optional(&mut tx).await?;
        tx.commit().await?;
        Ok(count.unwrap_or(0))
    }

    /// Forgets the counts of [`Self::count_interrupted_validation`]: the server is stopped and did not fail.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn forget_interrupted_validations(&self) -> Result<(), StoreError> {
        let mut tx = self.write().await?;
        sql::query("UPDATE uploads SET interrupted_validations = 0 WHERE interrupted_validations > 0")
            .execute(&mut tx)
            .await?;
        Ok(tx.commit().await?)
    }

    /// The captures of all tenants that are being made, or could not be made.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn unfinished_captures(&self) -> Result<HashSet<String>, StoreError> {
        let query = sql::query_scalar("SELECT capture_id FROM uploads WHERE capture_id IS NOT NULL");
        let ids: Vec<String> = query.fetch_all(self.pool()).await?;
        Ok(ids.into_iter().collect())
    }

    /// Deletes an upload of which no capture could be made; `false` while one is being made.
    ///
    /// # Errors
    /// When the database or the file system fails.
    pub async fn drop_invalid(&self, upload: &UploadRecord) -> Result<bool, StoreError> {
        match self.lock_upload(&upload.id) {
            Some(lock) => self.drop_upload(&lock).await.map(|()| true),
            None => Ok(false),
        }
    }
}
