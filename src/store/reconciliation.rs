//! Object-store reconciliation: sends local artifacts to the object store and removes objects without a reference. Objects
//! younger than a day are kept, because another machine may be writing them.

use std::collections::{HashMap, HashSet};
use std::time::{Duration, SystemTime};

use crate::store::artifacts::Remote;
use crate::store::exports::EXPORTS;
use crate::store::orphan_cleanup::{ORPHAN_RETENTION, ORPHANS, model_of};
use crate::store::references::{is_artifact_name, names, references};
use crate::store::{Store, StoreError, sql};

/// Minimum age of an unreferenced object before it is removed.
const MIN_ORPHAN_AGE: Duration = Duration::from_secs(24 * 3600);

/// Result of a reconciliation.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ReconciliationReport {
    /// Files that were sent to the object store.
    pub sent: usize,
    /// Objects that were removed.
    pub removed: usize,
    /// Objects that were moved to the orphans folder.
    pub set_aside: usize,
}

impl Store {
    /// Sends artifacts that the database references and that only this machine has to the object store. There it removes leftover
    /// objects of known jobs' attempts, of known models and of exports, and moves objects that the database does not know to the orphans folder
    /// for seven days. Does nothing without an object store, or if the database has never named an artifact. The caller must hold
    /// the lock of the data directory and be the only server on the database.
    ///
    /// # Errors
    /// When the database, the object store or a file operation fails. The next run continues.
    pub async fn reconcile_artifacts(&self, now: SystemTime) -> Result<ReconciliationReport, StoreError> {
        let mut report = ReconciliationReport::default();
        let Some(remote) = self.artifacts.remote() else { return Ok(report) };
        let objects = remote.list("").await?;
        if names(self.pool()).await?.is_empty() {
            return Ok(report);
        }
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

    /// Sends referenced files that are missing in the object store; `sizes` are those of its objects. Returns the number of
    /// files.
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
                    tracing::info!(key, "sent a local artifact to the object store");
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

    /// Removes an object or moves it to the orphans folder, unless the database references it by now.
    async fn remove_or_set_aside(
        &self,
        remote: &Remote,
        key: &str,
        report: &mut ReconciliationReport,
    ) -> Result<(), StoreError> {
        // A concurrent publication waits for this lock and then checks whether the object store has the object.
        let _publish_guard = self.publish_lock.lock().await;
        if references(self.pool()).await?.iter().any(|reference| reference.artifact == key) {
            return Ok(());
        }
        let job = key.strip_prefix("attempts/").and_then(|rest| rest.split('/').next());
        let is_known = match (job, model_of(key)) {
            (Some(job), _) => {
                let query = sql::query_scalar("SELECT EXISTS (SELECT 1 FROM jobs WHERE id = $1)").bind(job);
                query.fetch_one(self.pool()).await?
            }
            (None, Some(model)) => {
                let query =
                    sql::query_scalar("SELECT EXISTS (SELECT 1 FROM models WHERE id = $1)").bind(model);
                query.fetch_one(self.pool()).await?
            }
            (None, None) => key.starts_with(EXPORTS),
        };
        if is_known {
            tracing::info!(key, "removed a leftover object of an attempt, a model or an export");
            remote.remove(key).await?;
            report.removed += 1;
        } else {
            tracing::warn!(key, "moved an object that the database does not know to the orphans folder");
            remote.rename(key, &format!("{ORPHANS}/{key}")).await?;
            report.set_aside += 1;
        }
        Ok(())
    }
}
