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

/// Numbers of resources of the kinds that have a retention.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ExpiryCounts {
    /// Jobs.
    pub jobs: usize,
    /// Captures.
    pub captures: usize,
    /// Models.
    pub models: usize,
    /// Exports.
    pub exports: usize,
}

impl ExpiryCounts {
    /// Combines both numbers of each kind.
    pub fn zip(self, other: Self, combine: impl Fn(usize, usize) -> usize) -> Self {
        Self {
            jobs: combine(self.jobs, other.jobs),
            captures: combine(self.captures, other.captures),
            models: combine(self.models, other.models),
            exports: combine(self.exports, other.exports),
        }
    }

    fn of(&mut self, kind: ResourceKind) -> &mut usize {
        match kind {
            ResourceKind::Job => &mut self.jobs,
            ResourceKind::Capture => &mut self.captures,
            _ => &mut self.models,
        }
    }
}

impl Retention {
    /// Whether everything is kept until it is deleted.
    pub fn keeps_everything(&self) -> bool {
        *self == Self::default()
    }
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
    /// Numbers of the resources that have a retention and are not deleted.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn count_for_retention(&self) -> Result<ExpiryCounts, StoreError> {
        let query = "SELECT (SELECT COUNT(*) FROM jobs WHERE deleted_ms IS NULL),
             (SELECT COUNT(*) FROM captures WHERE deleted_ms IS NULL), (SELECT COUNT(*) FROM models WHERE deleted_ms IS NULL),
             (SELECT COUNT(*) FROM exports WHERE deleted_ms IS NULL)";
        let counts: (i64, i64, i64, i64) = sql::query_as(query).fetch_one(self.pool()).await?;
        let [jobs, captures, models, exports] =
            [counts.0, counts.1, counts.2, counts.3].map(|n| usize::try_from(n).unwrap_or_default());
        Ok(ExpiryCounts { jobs, captures, models, exports })
    }

    /// Deletes at most `most` resources beyond their retention that are not needed. Returns the numbers of deleted resources.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn expire(
        &self,
        retention: &Retention,
        mut most: ExpiryCounts,
        now_ms: i64,
    ) -> Result<ExpiryCounts, StoreError> {
        let mut deleted = ExpiryCounts::default();
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
                // A resource that is in use does not count.
                if *deleted.of(kind) >= *most.of(kind) {
                    break;
                }
                let name = ResourceName::new(kind, id);
                if self.delete(&tenant, &name, false, now_ms).await? == Deletion::Done {
                    tracing::info!(%name, "deleted a resource at the end of its retention");
                    *deleted.of(kind) += 1;
                }
            }
        }
        if let Some(keep) = retention.exports {
            deleted.exports = self.expire_exports(keep, most.exports, now_ms).await?;
            if deleted.exports > 0 {
                tracing::info!(count = deleted.exports, "deleted exports at the end of their retention");
            }
        }
        Ok(deleted)
    }
}
