//! Deletion of resources, with notification of workers and listeners.

use crate::jobs::queue::Jobs;
use crate::store::{Deletion, DeletionReport, ExportDeletion, StoreError};
use relume_api::{ExportId, ResourceName, TenantId};

impl Jobs {
    /// Deletes a capture, an environment, a job or a model of a tenant; see [`crate::store::Store::delete`]. On a full disk it
    /// releases the reserve first.
    ///
    /// # Errors
    /// When the database fails. Then nothing is deleted.
    pub async fn delete(
        &self,
        tenant: &TenantId,
        what: &ResourceName,
        cascade: bool,
    ) -> Result<Deletion, StoreError> {
        let deleted = match self.store.delete(tenant, what, cascade, self.now_ms()).await {
            Err(StoreError::Full) if self.store.disk_space().spend_reserve() => {
                self.store.delete(tenant, what, cascade, self.now_ms()).await
            }
            deleted => deleted,
        };
        self.announce_all();
        deleted
    }

    /// Cancels or deletes an export of a tenant; see [`crate::store::Store::delete_export`]. On a full disk it releases the reserve
    /// first.
    ///
    /// # Errors
    /// When the database fails. Then nothing is deleted.
    pub async fn delete_export(
        &self,
        tenant: &TenantId,
        id: &ExportId,
    ) -> Result<ExportDeletion, StoreError> {
        match self.store.delete_export(tenant, id, self.now_ms()).await {
            Err(StoreError::Full) if self.store.disk_space().spend_reserve() => {
                self.store.delete_export(tenant, id, self.now_ms()).await
            }
            deleted => deleted,
        }
    }

    /// Deletes expired uploads, then removes the files of all deleted resources.
    ///
    /// # Errors
    /// When the database or a file operation fails.
    pub async fn collect_garbage(&self) -> Result<DeletionReport, StoreError> {
        let now_ms = self.now_ms();
        self.store.expire_uploads(now_ms).await?;
        self.store.remove_deleted_files(now_ms).await
    }
}
