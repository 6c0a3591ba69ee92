//! Captures.

use sqlx::types::Json;

use crate::api::{CaptureId, TenantId, UploadId};
use crate::store::marks::{filtered, wanted};
use crate::store::{CaptureRecord, Filter, Page, Store, StoreError};

impl Store {
    /// Records a capture, or returns the one of the same tenant and content that was there first. The upload that it is made of is
    /// forgotten in the same transaction, unless it was to become another capture than the one returned.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn insert_capture(
        &self,
        tenant: &TenantId,
        capture: &CaptureRecord,
        made_of: Option<&UploadId>,
    ) -> Result<CaptureRecord, StoreError> {
        let mut tx = self.write().await?;
        sqlx::query(
            "INSERT INTO captures (id, sha256, bytes, artifact, report, created_ms, tenant)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7) ON CONFLICT (tenant, sha256) DO NOTHING",
        )
        .bind(&capture.id)
        .bind(&capture.sha256)
        .bind(capture.bytes)
        .bind(&capture.artifact)
        .bind(Json(&capture.report))
        .bind(capture.created_ms)
        .bind(tenant)
        .execute(&mut *tx)
        .await?;
        let stored: CaptureRecord =
            sqlx::query_as("SELECT * FROM captures WHERE sha256 = ?1 AND tenant = ?2")
                .bind(&capture.sha256)
                .bind(tenant)
                .fetch_one(&mut *tx)
                .await?;
        // One that another capture was promised of stays, to say what came of that.
        sqlx::query("DELETE FROM uploads WHERE id = ?1 AND (capture_id IS NULL OR capture_id = ?2)")
            .bind(made_of)
            .bind(&stored.id)
            .execute(&mut *tx)
            .await?;
        tx.commit().await?;
        Ok(stored)
    }

    /// A capture of a tenant by identifier.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn capture(
        &self,
        tenant: &TenantId,
        id: &CaptureId,
    ) -> Result<Option<CaptureRecord>, StoreError> {
        let query =
            sqlx::query_as("SELECT * FROM captures WHERE id = ?1 AND tenant = ?2 AND deleted_ms IS NULL")
                .bind(id)
                .bind(tenant);
        Ok(query.fetch_optional(self.pool()).await?)
    }

    /// A capture of a tenant by content.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn capture_by_hash(
        &self,
        tenant: &TenantId,
        sha256: &str,
    ) -> Result<Option<CaptureRecord>, StoreError> {
        let query = sqlx::query_as("SELECT * FROM captures WHERE sha256 = ?1 AND tenant = ?2")
            .bind(sha256)
            .bind(tenant);
        Ok(query.fetch_optional(self.pool()).await?)
    }

    /// Captures of a tenant that are called so, newest first.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn captures(
        &self,
        tenant: &TenantId,
        filter: &Filter,
        page: &Page,
    ) -> Result<Vec<CaptureRecord>, StoreError> {
        let query = concat!(
            "SELECT * FROM captures WHERE ",
            wanted!(),
            " AND tenant = ?6 AND deleted_ms IS NULL
               AND (?4 IS NULL OR (created_ms, id) < (SELECT created_ms, id FROM captures WHERE id = ?4))
             ORDER BY created_ms DESC, id DESC LIMIT ?5"
        );
        let query = filtered(query, filter).bind(&page.before).bind(page.limit).bind(tenant);
        Ok(query.fetch_all(self.pool()).await?)
    }
}
