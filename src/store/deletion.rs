//! Deletion of resources. A resource is soft-deleted in one transaction and is invisible from then on. Its files are removed
//! afterwards (`discard.rs`), so that a server that terminates in between leaves nothing half deleted.

use serde_json::json;

use crate::store::exports::delete_exports_of;
use crate::store::sql::{self, Tx};
use crate::store::{JobRecord, Store, StoreError, events};
use relume_api::jobs::JobState;
use relume_api::{JobId, ResourceKind, ResourceName, TenantId};

/// Outcome of a request to delete.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Deletion {
    /// The resource is deleted.
    Done,
    /// The resource does not exist.
    NotFound,
    /// These resources need it; nothing was deleted.
    InUse(Vec<ResourceName>),
}

impl Store {
    /// Deletes a capture, an environment, a job or a model of a tenant. With `cascade` also deletes the resources that need it; a
    /// running job is cancelled.
    ///
    /// The model of a deleted job is kept, and so is the record of a deleted model's job.
    ///
    /// # Errors
    /// When the database fails. Then nothing is deleted.
    pub async fn delete(
        &self,
        tenant: &TenantId,
        what: &ResourceName,
        cascade: bool,
        now_ms: i64,
    ) -> Result<Deletion, StoreError> {
        let mut tx = self.write().await?;
        let live: Option<String> =
            sql::query_scalar(live(what.kind)).bind(&what.id).bind(tenant).fetch_optional(&mut tx).await?;
        if live.is_none() {
            return Ok(Deletion::NotFound);
        }
        let needed_by = needed_by(&mut tx, what).await?;
        if !needed_by.is_empty() && !cascade {
            return Ok(Deletion::InUse(needed_by));
        }
        for job in &needed_by {
            soft_delete_job(&mut tx, &job.id, now_ms).await?;
        }
        soft_delete(&mut tx, what, now_ms).await?;
        tx.commit().await?;
        Ok(Deletion::Done)
    }
}

/// Refuses a job if its capture, known light or predecessor was deleted after the request was checked.
pub(super) async fn check_not_deleted(tx: &mut Tx, job: &JobRecord) -> Result<(), StoreError> {
    let light = job.request.overrides.light.as_ref().map(|light| light.environment.clone());
    let named = [
        (ResourceKind::Capture, Some(job.request.capture.to_string())),
        (ResourceKind::Job, job.retry_of.as_ref().map(JobId::to_string)),
    ];
    for (kind, id) in named {
        let Some(id) = id else { continue };
        let found: Option<String> =
            sql::query_scalar(live(kind)).bind(&id).bind(&job.tenant).fetch_optional(&mut *tx).await?;
        if found.is_none() {
            return Err(StoreError::Deleted(ResourceName::new(kind, id)));
        }
    }
    // A name that is not an identifier is a built-in map.
    let deleted = "SELECT id FROM environments WHERE id = $1 AND deleted_ms IS NOT NULL";
    let deleted: Option<String> = sql::query_scalar(deleted).bind(&light).fetch_optional(&mut *tx).await?;
    match (deleted, light) {
        (Some(_), Some(id)) => Err(StoreError::Deleted(ResourceName::new(ResourceKind::Environment, id))),
        _ => Ok(()),
    }
}

/// A query for whether the resource `$1` of the tenant `$2` exists.
fn live(kind: ResourceKind) -> &'static str {
    match kind {
        ResourceKind::Capture => {
            "SELECT id FROM captures WHERE id = $1 AND tenant = $2 AND deleted_ms IS NULL"
        }
        ResourceKind::Environment => {
            "SELECT id FROM environments WHERE id = $1 AND tenant = $2 AND deleted_ms IS NULL"
        }
        ResourceKind::Job => "SELECT id FROM jobs WHERE id = $1 AND tenant = $2 AND deleted_ms IS NULL",
        ResourceKind::Model => "SELECT id FROM models WHERE id = $1 AND tenant = $2 AND deleted_ms IS NULL",
    }
}

/// The jobs that need a resource: queued and running jobs, and jobs that can be retried. A job needs itself while it runs.
/// Nothing needs a model.
async fn needed_by(tx: &mut Tx, what: &ResourceName) -> Result<Vec<ResourceName>, StoreError> {
    let jobs = match what.kind {
        ResourceKind::Capture => {
            "SELECT id FROM jobs WHERE capture_id = $1 AND state NOT IN ('succeeded', 'rejected') AND deleted_ms IS NULL
             ORDER BY created_ms, id"
        }
        ResourceKind::Environment => {
            "SELECT id FROM jobs WHERE overrides -> 'light' ->> 'environment' = $1
                 AND state NOT IN ('succeeded', 'rejected') AND deleted_ms IS NULL
             ORDER BY created_ms, id"
        }
        ResourceKind::Job => "SELECT id FROM jobs WHERE id = $1 AND state IN ('running', 'cancelling')",
        ResourceKind::Model => return Ok(Vec::new()),
    };
    let jobs: Vec<String> = sql::query_scalar(jobs).bind(&what.id).fetch_all(&mut *tx).await?;
    Ok(jobs.into_iter().map(|id| ResourceName::new(ResourceKind::Job, id)).collect())
}

async fn soft_delete(tx: &mut Tx, what: &ResourceName, now_ms: i64) -> Result<(), StoreError> {
    // The hash becomes available for another upload of the same content.
    let update = match what.kind {
        ResourceKind::Job => return soft_delete_job(tx, &what.id, now_ms).await,
        ResourceKind::Capture => {
            "UPDATE captures SET deleted_ms = $2, sha256 = 'deleted ' || id WHERE id = $1"
        }
        ResourceKind::Environment => {
            "UPDATE environments SET deleted_ms = $2, sha256 = 'deleted ' || id WHERE id = $1"
        }
        ResourceKind::Model => "UPDATE models SET deleted_ms = $2 WHERE id = $1",
    };
    sql::query(update).bind(&what.id).bind(now_ms).execute(&mut *tx).await?;
    if what.kind == ResourceKind::Model {
        let told = "UPDATE jobs SET model_deleted_ms = $2 WHERE model_id = $1";
        sql::query(told).bind(&what.id).bind(now_ms).execute(&mut *tx).await?;
        delete_exports_of(tx, &what.id, now_ms).await?;
    }
    Ok(())
}

/// Soft-deletes a job. A queued job is cancelled; a running job is asked to stop.
async fn soft_delete_job(tx: &mut Tx, id: &str, now_ms: i64) -> Result<(), StoreError> {
    let before: Option<JobState> =
        sql::query_scalar("SELECT state FROM jobs WHERE id = $1").bind(id).fetch_optional(&mut *tx).await?;
    let after: Option<JobState> = sql::query_scalar(
        "UPDATE jobs SET deleted_ms = $2, eta_seconds = NULL,
             finished_ms = CASE state WHEN 'queued' THEN $2 ELSE finished_ms END,
             state = CASE state WHEN 'queued' THEN 'cancelled' WHEN 'running' THEN 'cancelling' ELSE state END
         WHERE id = $1 AND deleted_ms IS NULL RETURNING state",
    )
    .bind(id)
    .bind(now_ms)
    .fetch_optional(&mut *tx)
    .await?;
    if let Some(state) = after
        && before != after
    {
        let data = json!({ "state": state });
        events::append_state(tx, &id.into(), now_ms, state, data).await?;
    }
    Ok(())
}
