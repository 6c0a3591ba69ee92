//! Where uploads get their place: file and row together, one after another, so that no sweep comes in between.

use crate::api::TenantId;
use crate::store::{CaptureRecord, EnvironmentRecord, Incoming, Store, StoreError};

impl Store {
    /// Publishes an upload and records it, or returns the capture of the same tenant and content that was there first.
    ///
    /// # Errors
    /// When the move or the database fails.
    pub async fn keep_capture(
        &self,
        incoming: Incoming,
        tenant: &TenantId,
        capture: &CaptureRecord,
    ) -> Result<CaptureRecord, StoreError> {
        let _shelf = self.shelf.lock().await;
        self.artifacts.publish(incoming, &capture.artifact).await?;
        self.insert_capture(tenant, capture).await
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
        let _shelf = self.shelf.lock().await;
        self.artifacts.publish(incoming, &environment.artifact).await?;
        self.insert_environment(tenant, environment).await
    }

    /// Puts a complete upload in the place of an artifact of the same content that is damaged or missing; drops it otherwise.
    /// Gives the upload back when nothing names that artifact any more.
    ///
    /// # Errors
    /// When the artifact cannot be read or the move fails.
    pub async fn mend(&self, incoming: Incoming, artifact: &str) -> Result<Option<Incoming>, StoreError> {
        match self.artifacts.verify(artifact, &incoming.sha256).await {
            Err(StoreError::Damaged(_) | StoreError::Missing(_)) => {}
            sound => return sound.map(|()| None),
        }
        let _shelf = self.shelf.lock().await;
        let named = "SELECT EXISTS (SELECT 1 FROM captures WHERE artifact = ?1 AND deleted_ms IS NULL)
                         OR EXISTS (SELECT 1 FROM environments WHERE artifact = ?1 AND deleted_ms IS NULL)";
        if sqlx::query_scalar(named).bind(artifact).fetch_one(self.pool()).await? {
            self.artifacts.publish(incoming, artifact).await?;
            return Ok(None);
        }
        Ok(Some(incoming))
    }
}
