//! Captures.

use sqlx::types::Json;

use crate::store::metadata::{change_metadata_in_tx, filtered, listed};
use crate::store::{CaptureRecord, Filter, Page, Store, StoreError, sql};
use relume_api::metadata::ResourceMetadata;
use relume_api::{CaptureId, ResourceKind, ResourceName, TenantId, UploadId};

impl Store {
    /// Records a capture. If the tenant already has a capture with the same content, returns that one and changes its metadata to
    /// those of `capture`. Removes the upload `made_of` in the same transaction, unless the upload was announced as another
    /// capture than the returned one. If the capture was announced before, it gets the current metadata of its upload.
    ///
    /// # Errors
    /// [`StoreError::InvalidMetadata`] if the existing capture cannot have these metadata. When the database fails.
    pub async fn insert_capture(
        &self,
        tenant: &TenantId,
        capture: &CaptureRecord,
        made_of: Option<&UploadId>,
    ) -> Result<CaptureRecord, StoreError> {
        let mut tx = self.write().await?;
        let promised: Option<ResourceMetadata> =
            sql::query_as("SELECT name, external_id, labels FROM uploads WHERE id = $1 AND capture_id = $2")
                .bind(made_of)
                .bind(&capture.id)
                .fetch_optional(&mut tx)
                .await?;
        let metadata = promised.as_ref().unwrap_or(&capture.metadata);
        sql::query(
            "INSERT INTO captures
                 (id, sha256, bytes, artifact, report, created_ms, tenant, name, external_id, labels, made_of)
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11) ON CONFLICT (tenant, sha256) DO NOTHING",
        )
        .bind(&capture.id)
        .bind(&capture.sha256)
        .bind(capture.bytes)
        .bind(&capture.artifact)
        .bind(Json(&capture.report))
        .bind(capture.created_ms)
        .bind(tenant)
        .bind(&metadata.name)
        .bind(&metadata.external_id)
        .bind(Json(&metadata.labels))
        .bind(&capture.made_of)
        .execute(&mut tx)
        .await?;
        let mut stored: CaptureRecord =
            sql::query_as("SELECT * FROM captures WHERE sha256 = $1 AND tenant = $2")
                .bind(&capture.sha256)
                .bind(tenant)
                .fetch_one(&mut tx)
                .await?;
        if stored.id != capture.id {
            let what = ResourceName::new(ResourceKind::Capture, stored.id.to_string());
            let change = capture.metadata.clone().into();
            stored.metadata =
                change_metadata_in_tx(&mut tx, tenant, &what, &change).await?.unwrap_or(stored.metadata);
        }
        // An upload that was announced as another capture is kept; it records the result.
        sql::query("DELETE FROM uploads WHERE id = $1 AND (capture_id IS NULL OR capture_id = $2)")
            .bind(made_of)
            .bind(&stored.id)
            .execute(&mut tx)
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
            sql::query_as("SELECT * FROM captures WHERE id = $1 AND tenant = $2 AND deleted_ms IS NULL")
                .bind(id)
                .bind(tenant);
        Ok(query.fetch_optional(self.pool()).await?)
    }

    /// The capture of a tenant with this content, else the newest one that was made of it: of photographs without poses.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn capture_of_content(
        &self,
        tenant: &TenantId,
        sha256: &str,
    ) -> Result<Option<CaptureRecord>, StoreError> {
        let query = sql::query_as(
            "SELECT * FROM captures WHERE tenant = $1 AND (sha256 = $2 OR made_of = $2) AND deleted_ms IS NULL
             ORDER BY CASE sha256 WHEN $2 THEN 0 ELSE 1 END, created_ms DESC, id DESC LIMIT 1",
        );
        Ok(query.bind(tenant).bind(sha256).fetch_optional(self.pool()).await?)
    }

    /// Captures of a tenant that match the filter, newest first.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn captures(
        &self,
        tenant: &TenantId,
        filter: &Filter,
        page: &Page,
    ) -> Result<Vec<CaptureRecord>, StoreError> {
        let query = listed!(
            "captures",
            "AND tenant = $6 AND deleted_ms IS NULL
               AND ($4 IS NULL OR (created_ms, id) < ($7, $4))
             ORDER BY created_ms DESC, id DESC LIMIT $5"
        );
        let query =
            filtered(query, filter).bind(page.id()).bind(i64::from(page.limit)).bind(tenant).bind(page.at());
        Ok(query.fetch_all(self.pool()).await?)
    }
}
