//! Retention of resources.

use std::time::Duration;

use crate::store::{Deletion, Store, StoreError, sql};
use relume_api::{ResourceKind, ResourceName, TenantId};

/// The retention of resources. Resources without a retention, or with the label `keep:true`, are kept until they are deleted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Retention {
    /// Of jobs, since their end.
    pub jobs: Option<Duration>,
    /// Of captures, since their upload and the submission of their newest job.
    pub captures: Option<Duration>,
    /// Of models, since their publication.
    pub models: Option<Duration>,
    /// Of exports, since their end.
    pub exports: Option<Duration>,
}

/// Resources of a kind that are older than `$1`, oldest first, with a limit so that no run takes long. Resources with the label
/// `keep:true` are excluded.
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
    /// Deletes resources beyond their retention that are not needed. Returns the deleted resources without exports.
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
                    tracing::info!(%name, "deleted a resource at the end of its retention");
                    deleted.push(name);
                }
            }
        }
        if let Some(keep) = retention.exports {
            let count = self.expire_exports(keep, now_ms).await?;
            if count > 0 {
                tracing::info!(count, "deleted exports at the end of their retention");
            }
        }
        Ok(deleted)
    }
}
