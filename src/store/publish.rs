//! Publication of uploads: moves the file and writes the row under one lock, so that no garbage collection runs in between.

use crate::store::{CaptureRecord, EnvironmentRecord, StagedUpload, Store, StoreError, UploadLock, sql};
use relume_api::TenantId;

impl Store {
    /// Publishes an upload and records it as a capture, or returns the tenant's existing capture of the same content. Then
    /// removes its resumable upload, if any.
    ///
    /// # Errors
    /// When the move or the database fails.
    pub async fn publish_capture(
        &self,
        mut incoming: StagedUpload,
        tenant: &TenantId,
        capture: &CaptureRecord,
    ) -> Result<CaptureRecord, StoreError> {
        self.artifacts.upload_file(&incoming.path, &capture.artifact).await?;
        let _publish_guard = self.publish_lock.lock().await;
        let pieces = incoming.upload.take();
        self.artifacts.publish(incoming, &capture.artifact).await?;
        let stored = self.insert_capture(tenant, capture, pieces.as_ref().map(UploadLock::id)).await?;
        if let Some(pieces) = &pieces
            && !self.has_upload(pieces.id()).await?
            && let Err(error) = self.drop_upload(pieces).await
        {
            tracing::warn!(%error, "cannot remove the bytes of an upload; the next start removes them");
        }
        Ok(stored)
    }

    /// As [`Store::publish_capture`], for an environment.
    ///
    /// # Errors
    /// When the move or the database fails.
    pub async fn publish_environment(
        &self,
        incoming: StagedUpload,
        tenant: &TenantId,
        environment: &EnvironmentRecord,
    ) -> Result<EnvironmentRecord, StoreError> {
        self.artifacts.upload_file(&incoming.path, &environment.artifact).await?;
        let _publish_guard = self.publish_lock.lock().await;
        self.artifacts.publish(incoming, &environment.artifact).await?;
        self.insert_environment(tenant, environment).await
    }

    /// Replaces a damaged or missing artifact by a complete upload of the same content; otherwise discards the upload. Returns
    /// the upload if nothing references the artifact any more.
    ///
    /// # Errors
    /// When the artifact cannot be read or the move fails.
    pub async fn repair_artifact(
        &self,
        mut incoming: StagedUpload,
        artifact: &str,
    ) -> Result<Option<StagedUpload>, StoreError> {
        if self.is_intact(artifact, &incoming).await? {
            return self.discard_duplicate(incoming).await.map(|()| None);
        }
        self.artifacts.upload_file(&incoming.path, artifact).await?;
        let _publish_guard = self.publish_lock.lock().await;
        let named = "SELECT EXISTS (SELECT 1 FROM captures WHERE artifact = $1 AND deleted_ms IS NULL)
                         OR EXISTS (SELECT 1 FROM environments WHERE artifact = $1 AND deleted_ms IS NULL)";
        if sql::query_scalar(named).bind(artifact).fetch_one(self.pool()).await? {
            let pieces = incoming.upload.take();
            self.artifacts.publish(incoming, artifact).await?;
            if let Some(pieces) = pieces {
                self.drop_upload(&pieces).await?;
            }
            return Ok(None);
        }
        Ok(Some(incoming))
    }

    /// Whether an artifact matches an upload of the same content, on this machine and in the object store.
    async fn is_intact(&self, artifact: &str, incoming: &StagedUpload) -> Result<bool, StoreError> {
        match self.artifacts.verify(artifact, &incoming.sha256).await {
            Err(StoreError::Damaged(_) | StoreError::Missing(_)) => Ok(false),
            Err(error) => Err(error),
            Ok(()) => match self.artifacts.remote() {
                Some(remote) => Ok(remote.size(artifact).await? == Some(incoming.bytes)),
                None => Ok(true),
            },
        }
    }

    /// Discards an upload whose content already exists, including its resumable upload.
    ///
    /// # Errors
    /// When the database or the file system fails.
    pub async fn discard_duplicate(&self, mut incoming: StagedUpload) -> Result<(), StoreError> {
        match incoming.upload.take() {
            Some(pieces) => self.drop_upload(&pieces).await,
            None => Ok(()),
        }
    }
}
