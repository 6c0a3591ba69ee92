//! Captures.

use sqlx::types::Json;

use crate::api::CaptureId;
use crate::store::{CaptureRecord, Page, Store, StoreError};

impl Store {
    /// Records a capture, or returns the one of the same content that was there first.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn insert_capture(&self, capture: &CaptureRecord) -> Result<CaptureRecord, StoreError> {
        let mut tx = self.write().await?;
        sqlx::query(
            "INSERT INTO captures (id, sha256, bytes, artifact, report, created_ms)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6) ON CONFLICT (sha256) DO NOTHING",
        )
        .bind(&capture.id)
        .bind(&capture.sha256)
        .bind(capture.bytes)
        .bind(&capture.artifact)
        .bind(Json(&capture.report))
        .bind(capture.created_ms)
        .execute(&mut *tx)
        .await?;
        let stored = sqlx::query_as("SELECT * FROM captures WHERE sha256 = ?1")
            .bind(&capture.sha256)
            .fetch_one(&mut *tx)
            .await?;
        tx.commit().await?;
        Ok(stored)
    }

    /// A capture by identifier.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn capture(&self, id: &CaptureId) -> Result<Option<CaptureRecord>, StoreError> {
        let query = sqlx::query_as("SELECT * FROM captures WHERE id = ?1 AND deleted_ms IS NULL").bind(id);
        Ok(query.fetch_optional(self.pool()).await?)
    }

    /// A capture by content.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn capture_by_hash(&self, sha256: &str) -> Result<Option<CaptureRecord>, StoreError> {
        let query = sqlx::query_as("SELECT * FROM captures WHERE sha256 = ?1").bind(sha256);
        Ok(query.fetch_optional(self.pool()).await?)
    }

    /// Captures, newest first.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn captures(&self, page: &Page) -> Result<Vec<CaptureRecord>, StoreError> {
        let query = sqlx::query_as(
            "SELECT * FROM captures
             WHERE deleted_ms IS NULL
               AND (?1 IS NULL OR (created_ms, id) < (SELECT created_ms, id FROM captures WHERE id = ?1))
             ORDER BY created_ms DESC, id DESC LIMIT ?2",
        );
        Ok(query.bind(&page.before).bind(page.limit).fetch_all(self.pool()).await?)
    }
}
