//! How long things are kept.

use std::time::Duration;

use crate::store::sql;
use crate::store::{Deletion, Store, StoreError};
use relume_api::{ResourceKind, ResourceName, TenantId};

/// How long things are kept; what has no time, or the label `keep:true`, is kept until it is deleted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Retention {
    /// Jobs, since they ended.
    pub jobs: Option<Duration>,
    /// Captures, since their upload and the submission of their newest job.
    pub captures: Option<Duration>,
    /// Models, since their publication.
    pub models: Option<Duration>,
    /// Exports, since they ended.
    pub exports: Option<Duration>,
}

/// The things of a kind that are older than `$1`, oldest first; few at a time, so that no sweep takes long.
/// A label `keep:true` keeps them.
const EXPIRED: [(ResourceKind, &str); 3] = [
    (
        ResourceKind::Job,
        "SELECT id, tenant FROM jobs WHERE deleted_ms IS NULL AND finished_ms < $1
             AND COALESCE(labels ->> 'keep', '') <> 'true'
             AND state IN ('succeeded', 'rejected', 'failed', 'cancelled') ORDER BY finished_ms LIMIT 1000",
    ),
    (
        ResourceKind::Capture,
        "SELECT id, tenant FROM captures WHERE deleted_ms IS NULL AND created_ms < $1
             AND COALESCE(labels ->> 'keep', '') <> 'true' AND NOT EXISTS
             (SELECT 1 FROM jobs WHERE capture_id = captures.id AND deleted_ms IS NULL
                  AND (state NOT IN ('succeeded', 'rejected') OR created_ms >= $1))
         ORDER BY created_ms LIMIT 1000",
    ),
    (
        ResourceKind::Model,
        "SELECT id, tenant FROM models WHERE deleted_ms IS NULL AND created_ms < $1
             AND COALESCE(labels ->> 'keep', '') <> 'true'
         ORDER BY created_ms LIMIT 1000",
    ),
];

impl Store {
    /// Deletes what has been kept for long enough and is not needed. Returns what was deleted beside exports.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn expire(&self, retention: &Retention, now_ms: i64) -> Result<Vec<ResourceName>, StoreError> {
        let mut deleted = Vec::new();
        for (kind, query) in EXPIRED {
            let keep = match kind {
                ResourceKind::Job => retention.jobs,
                ResourceKind::Capture => retention.captures,
                _ => retention.models,
            };
            let Some(keep) = keep else { continue };
            let before = now_ms.saturating_sub(i64::try_from(keep.as_millis()).unwrap_or(i64::MAX));
            let ids: Vec<(String, TenantId)> =
                sql::query_as(query).bind(before).fetch_all(self.pool()).await?;
            for (id, tenant) in ids {
                let name = ResourceName::new(kind, id);
                if self.delete(&tenant, &name, false, now_ms).await? == Deletion::Done {
                    tracing::info!(%name, "deleted what was kept for long enough");
                    deleted.push(name);
                }
            }
        }
        if let Some(keep) = retention.exports {
            let count = self.expire_exports(keep, now_ms).await?;
            if count > 0 {
                tracing::info!(count, "deleted exports that were kept for long enough");
            }
        }
        Ok(deleted)
    }
}
