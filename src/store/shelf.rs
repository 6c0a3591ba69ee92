//! Where uploads get their place: file and row together, one after another, so that no sweep comes in between.

use crate::api::TenantId;
use crate::store::sql;
use crate::store::{CaptureRecord, EnvironmentRecord, Hold, Incoming, Store, StoreError};

impl Store {
    /// Publishes an upload and records it, or returns the capture of the same tenant and content that was there first. Pieces that
    /// it came in are gone then.
    ///
    /// # Errors
    /// When the move or the database fails.
    pub async fn keep_capture(
        &self,
        mut incoming: Incoming,
        tenant: &TenantId,
        capture: &CaptureRecord,
    ) -> Result<CaptureRecord, StoreError> {
        self.artifacts.send_ahead(&incoming.path, &capture.artifact).await?;
        let _shelf = self.shelf.lock().await;
        let pieces = incoming.upload.take();
        self.artifacts.publish(incoming, &capture.artifact).await?;
        let stored = self.insert_capture(tenant, capture, pieces.as_ref().map(Hold::id)).await?;
        if let Some(pieces) = &pieces
            && !self.has_upload(pieces.id()).await?
            && let Err(error) = self.drop_upload(pieces).await
        {
            tracing::warn!(%error, "the next start removes the bytes of an upload");
        }
        Ok(stored)
    }

    /// As [`Store::keep_capture`], of an environment.
    ///
    /// # Errors
    /// When the move or the database fails.
    pub async fn keep_environment(
        &self,
        incoming: Incoming,
        tenant: &TenantId,
        environment: &EnvironmentRecord,
    ) -> Result<EnvironmentRecord, StoreError> {
        self.artifacts.send_ahead(&incoming.path, &environment.artifact).await?;
        let _shelf = self.shelf.lock().await;
        self.artifacts.publish(incoming, &environment.artifact).await?;
        self.insert_environment(tenant, environment).await
    }

    /// Puts a complete upload in the place of an artifact of the same content that is damaged or missing; drops it otherwise.
    /// Gives the upload back when nothing names that artifact any more.
    ///
    /// # Errors
    /// When the artifact cannot be read or the move fails.
    pub async fn mend(&self, mut incoming: Incoming, artifact: &str) -> Result<Option<Incoming>, StoreError> {
        if self.is_sound(artifact, &incoming).await? {
            return self.forget_pieces(incoming).await.map(|()| None);
        }
        self.artifacts.send_ahead(&incoming.path, artifact).await?;
        let _shelf = self.shelf.lock().await;
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

    /// Whether an artifact is what an upload of the same content is, here and in the object store.
    async fn is_sound(&self, artifact: &str, incoming: &Incoming) -> Result<bool, StoreError> {
        match self.artifacts.verify(artifact, &incoming.sha256).await {
            Err(StoreError::Damaged(_) | StoreError::Missing(_)) => Ok(false),
            Err(error) => Err(error),
            Ok(()) => match self.artifacts.remote() {
                Some(remote) => Ok(remote.size(artifact).await? == Some(incoming.bytes)),
                None => Ok(true),
            },
        }
    }

    /// Drops an upload whose content is there already, with the pieces that it came in.
    ///
    /// # Errors
    /// When the database or the file system fails.
    pub async fn forget_pieces(&self, mut incoming: Incoming) -> Result<(), StoreError> {
        match incoming.upload.take() {
            Some(pieces) => self.drop_upload(&pieces).await,
            None => Ok(()),
        }
    }
}
