//! Exports: files that are made of models in the background. One conditional UPDATE claims an export. Every later write requires
//! the state `running`, so that a cancelled or deleted export stays so.

mod lifecycle;
mod record;
mod removal;

use sqlx::types::Json;

use crate::store::idempotency::{remember, replay};
use crate::store::sql::{self, Tx};
use crate::store::{IdempotencyKey, Page, Store, StoreError, Submitted};
use relume_api::exports::{ExportState, NewExport};
use relume_api::{ExportId, ModelId, ResourceKind, ResourceName, TenantId};

pub(super) use record::EXPORTS;
pub use record::{ClaimedExport, ExportRecord, ExportedFile};
pub use removal::ExportDeletion;
pub(super) use removal::delete_exports_of;

/// The columns for lists.
macro_rules! columns {
    () => {
        "id, tenant, model_id, kind, state, done, total, file_name, content_type, artifact, bytes, sha256, error_code,
         error_detail, created_ms, started_ms, finished_ms,
         CASE WHEN length(CAST(request AS TEXT)) <= 4096 THEN request END AS short_request"
    };
}
use columns;

impl Store {
    /// Queues an export and records the answer under its idempotency key, in one transaction. A tenant may have `most` queued and
    /// running exports.
    ///
    /// # Errors
    /// [`StoreError::IdempotencyKeyReused`] if the key was used with another request, [`StoreError::ExportQuotaExceeded`] beyond
    /// `most`, [`StoreError::Deleted`] if the model is deleted.
    pub async fn submit_export(
        &self,
        export: &ExportRecord,
        request: &NewExport,
        key: Option<&IdempotencyKey>,
        most: u32,
        answer: impl FnOnce(&ExportRecord) -> String + Send,
    ) -> Result<Submitted, StoreError> {
        self.admit().await?;
        let (mut tx, now_ms) = (self.write().await?, export.created_ms);
        if let Some(key) = key
            && let Some(response) = replay(&mut tx, &export.tenant, key, now_ms).await?
        {
            tx.commit().await?;
            return Ok(Submitted::Replayed(response));
        }
        let model =
            "SELECT EXISTS (SELECT 1 FROM models WHERE id = $1 AND tenant = $2 AND deleted_ms IS NULL)";
        let model = sql::query_scalar(model).bind(&export.model_id).bind(&export.tenant);
        if !model.fetch_one(&mut tx).await? {
            let model = ResourceName::new(ResourceKind::Model, export.model_id.to_string());
            return Err(StoreError::Deleted(model));
        }
        check_export_quota(&mut tx, &export.tenant, most).await?;
        sql::query(
            "INSERT INTO exports (id, tenant, model_id, kind, request, state, total, created_ms)
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8)",
        )
        .bind(&export.id)
        .bind(&export.tenant)
        .bind(&export.model_id)
        .bind(export.kind)
        .bind(Json(request))
        .bind(export.state)
        .bind(export.progress.total)
        .bind(now_ms)
        .execute(&mut tx)
        .await?;
        let response = answer(export);
        if let Some(key) = key {
            remember(&mut tx, &export.tenant, key, &response, now_ms).await?;
        }
        tx.commit().await?;
        Ok(Submitted::Created(response))
    }

    /// An export of a tenant by identifier.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn export(&self, tenant: &TenantId, id: &ExportId) -> Result<Option<ExportRecord>, StoreError> {
        let query = concat!(
            "SELECT ",
            columns!(),
            " FROM exports WHERE id = $1 AND tenant = $2 AND deleted_ms IS NULL"
        );
        Ok(sql::query_as(query).bind(id).bind(tenant).fetch_optional(self.pool()).await?)
    }

    /// Exports of a tenant, newest first, optionally of one model or state.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn exports(
        &self,
        tenant: &TenantId,
        model: Option<&ModelId>,
        state: Option<ExportState>,
        page: &Page,
    ) -> Result<Vec<ExportRecord>, StoreError> {
        let query = concat!(
            "SELECT ",
            columns!(),
            " FROM exports WHERE tenant = $1 AND deleted_ms IS NULL
                 AND ($2 IS NULL OR model_id = $2) AND ($3 IS NULL OR state = $3)
                 AND ($4 IS NULL OR (created_ms, id) < ($5, $4))
             ORDER BY created_ms DESC, id DESC LIMIT $6"
        );
        let query = sql::query_as(query).bind(tenant).bind(model).bind(state).bind(page.id());
        Ok(query.bind(page.at()).bind(i64::from(page.limit)).fetch_all(self.pool()).await?)
    }
}

/// Refuses another export of a tenant that has `most` queued and running exports.
async fn check_export_quota(tx: &mut Tx, tenant: &TenantId, most: u32) -> Result<(), StoreError> {
    let counting = "SELECT COUNT(*) FROM exports
                        WHERE tenant = $1 AND state IN ('queued', 'running') AND deleted_ms IS NULL";
    let count: i64 = sql::query_scalar(counting).bind(tenant).fetch_one(&mut *tx).await?;
    if count >= i64::from(most) { Err(StoreError::ExportQuotaExceeded { most }) } else { Ok(()) }
}
