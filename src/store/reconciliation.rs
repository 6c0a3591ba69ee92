//! Peace between a folder of artifacts, the object store and the database: what only this machine has is sent there, and what
//! nothing refers to there goes. Another machine may be writing meanwhile: what is younger than a day is left alone.

use std::collections::{HashMap, HashSet};
use std::time::{Duration, SystemTime};

use crate::store::artifacts::Remote;
use crate::store::exports::EXPORTS;
use crate::store::orphan_cleanup::{ORPHAN_RETENTION, ORPHANS};
use crate::store::references::{is_artifact_name, references};
use crate::store::sql;
use crate::store::{Store, StoreError};

/// How old an object is at least that nothing refers to, before it goes.
const MIN_ORPHAN_AGE: Duration = Duration::from_secs(24 * 3600);

/// What was done.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ReconciliationReport {
    /// Files that were sent to the object store.
    pub sent: usize,
    /// Objects that were removed.
    pub removed: usize,
    /// Objects that were set aside.
    pub set_aside: usize,
}

impl Store {
    /// Sends what only this machine has and the database names to the object store; removes there what attempts of known jobs and
    /// exports left, and sets aside for a week what the database knows nothing of. Does nothing without an object store. The
    /// caller must hold the node lock, and be the only server on the database.
    ///
    /// # Errors
    /// When the database, the object store or a file fails; the next time goes on from there.
    pub async fn reconcile_artifacts(&self, now: SystemTime) -> Result<ReconciliationReport, StoreError> {
        let Some(remote) = self.artifacts.remote() else { return Ok(ReconciliationReport::default()) };
        let mut report = ReconciliationReport::default();
        let objects = remote.list("").await?;
        let sizes: HashMap<&str, u64> =
            objects.iter().map(|object| (object.key.as_str(), object.bytes)).collect();
        report.sent = self.upload_local_only_files(&sizes).await?;
        let named: HashSet<String> =
            references(self.pool()).await?.into_iter().map(|reference| reference.artifact).collect();
        let age = |object: &crate::store::artifacts::RemoteObject| {
            now.duration_since(object.written).unwrap_or_default()
        };
        for object in &objects {
            let key = object.key.as_str();
            if key.strip_prefix(ORPHANS).is_some_and(|rest| rest.starts_with('/')) {
                if age(object) > ORPHAN_RETENTION {
                    remote.remove(key).await?;
                    report.removed += 1;
                }
            } else if is_artifact_name(key) && !named.contains(key) && age(object) > MIN_ORPHAN_AGE {
                self.remove_or_set_aside(remote, key, &mut report).await?;
            }
        }
        Ok(report)
    }

    /// Sends files that the database names and the object store, which has these objects, lacks; how many.
    async fn upload_local_only_files(&self, sizes: &HashMap<&str, u64>) -> Result<usize, StoreError> {
        let mut sent = 0;
        for reference in references(self.pool()).await? {
            let (key, sha256) = (reference.artifact.as_str(), reference.sha256.as_deref());
            let Ok(file) = tokio::fs::metadata(self.artifacts.local_path(key)).await else { continue };
            if sizes.get(key) == Some(&file.len()) {
                self.artifacts.is_in_object_store(key);
                continue;
            }
            match self.artifacts.upload_local(key, sha256).await {
                Ok(true) => {
                    tracing::info!(key, "sent an artifact to the object store that only this machine had");
                    sent += 1;
                }
                Ok(false) => {}
                Err(error @ (StoreError::Damaged(_) | StoreError::Missing(_))) => {
                    tracing::error!(%error, owner = reference.owner, "an artifact cannot be sent to the object store");
                }
                Err(error) => return Err(error),
            }
        }
        Ok(sent)
    }

    /// Removes an object, or sets it aside, unless the database names it by now.
    async fn remove_or_set_aside(
        &self,
        remote: &Remote,
        key: &str,
        report: &mut ReconciliationReport,
    ) -> Result<(), StoreError> {
        // What gets its place meanwhile is looked for in the object store once it has the publish lock.
        let _publish_guard = self.publish_lock.lock().await;
        if references(self.pool()).await?.iter().any(|reference| reference.artifact == key) {
            return Ok(());
        }
        let job = key.strip_prefix("attempts/").and_then(|rest| rest.split('/').next());
        let is_known = match job {
            Some(job) => {
                let query = sql::query_scalar("SELECT EXISTS (SELECT 1 FROM jobs WHERE id = $1)").bind(job);
                query.fetch_one(self.pool()).await?
            }
            None => key.starts_with(EXPORTS),
        };
        if is_known {
            tracing::info!(key, "removed from the object store what an attempt or an export left");
            remote.remove(key).await?;
            report.removed += 1;
        } else {
            tracing::warn!(key, "set aside an object that the database does not know");
            remote.rename(key, &format!("{ORPHANS}/{key}")).await?;
            report.set_aside += 1;
        }
        Ok(())
    }
}
