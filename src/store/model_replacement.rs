//! Replacement of the files of a model: new artifacts under new keys, then one transaction that names them in place of the old
//! ones. Old artifacts are kept for a while, because requests may still read them.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use sqlx::types::Json;

use crate::store::artifacts::is_key;
use crate::store::orphan_cleanup::{model_of, prune};
use crate::store::{ModelFile, Store, StoreError, sql};
use relume_api::{ExportId, ModelId, TenantId};

/// Folder of the artifacts of replaced models: `models/MODEL/VERSION/FILE`.
pub(super) const MODELS: &str = "models";
/// Time for which a replaced artifact is kept, milliseconds: longer than a URL of the object store is valid and than a frame waits.
const KEEP_MS: i64 = 20 * 60 * 1000;

/// Result of a replacement.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ModelReplacement {
    /// The model has the new files. These exports, which were queued or running, begin again with them.
    Done(Vec<ExportId>),
    /// The model does not exist, or its files were replaced in the meantime. Nothing was changed.
    Outdated,
}

/// The replaced artifacts that are to be removed, with the time from which they may be, milliseconds since 1970 UTC. The list is
/// lost when the server ends; the next start removes artifacts that the database does not name.
#[derive(Clone, Default)]
pub(super) struct ReplacedArtifacts(Arc<Mutex<Vec<(i64, String)>>>);

impl ReplacedArtifacts {
    fn lock(&self) -> MutexGuard<'_, Vec<(i64, String)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn due(&self, now_ms: i64) -> Vec<String> {
        self.lock().iter().filter(|(due, _)| *due <= now_ms).map(|(_, key)| key.clone()).collect()
    }
}

impl Store {
    /// The key of the file `name` of the version `version` of a model.
    pub fn model_artifact(model: &ModelId, version: &str, name: &str) -> String {
        format!("{MODELS}/{model}/{version}/{name}")
    }

    /// Replaces the card and files of a model in one transaction, and returns its unfinished exports to the queue, from the
    /// beginning. `files` are pairs of an old and a new file of the same name, whose artifact is stored already. Old artifacts are
    /// removed later.
    ///
    /// # Errors
    /// When the database fails. The model may be replaced nevertheless, unless the disk was full.
    pub async fn replace_model(
        &self,
        tenant: &TenantId,
        id: &ModelId,
        card: &serde_json::Value,
        files: &[(ModelFile, ModelFile)],
        now_ms: i64,
    ) -> Result<ModelReplacement, StoreError> {
        let mut tx = self.write().await?;
        let update = "UPDATE models SET card = $3 WHERE id = $1 AND tenant = $2 AND deleted_ms IS NULL";
        if sql::query(update).bind(id).bind(tenant).bind(Json(card)).execute(&mut tx).await? == 0 {
            return Ok(ModelReplacement::Outdated);
        }
        for (old, new) in files {
            let update = "UPDATE model_files SET bytes = $4, sha256 = $5, artifact = $6
                              WHERE model_id = $1 AND name = $2 AND artifact = $3";
            let update = sql::query(update).bind(id).bind(&old.name).bind(&old.artifact);
            let update = update.bind(new.bytes).bind(&new.sha256).bind(&new.artifact);
            if update.execute(&mut tx).await? == 0 {
                return Ok(ModelReplacement::Outdated);
            }
        }
        let again = "UPDATE exports SET state = 'queued', done = 0, work_bytes = 0
                         WHERE model_id = $1 AND state IN ('queued', 'running') AND deleted_ms IS NULL RETURNING id";
        let exports: Vec<ExportId> = sql::query_scalar(again).bind(id).fetch_all(&mut tx).await?;
        tx.commit().await?;
        let due = now_ms.saturating_add(KEEP_MS);
        self.replaced_artifacts.lock().extend(files.iter().map(|(old, _)| (due, old.artifact.clone())));
        Ok(ModelReplacement::Done(exports))
    }

    /// Removes the replaced artifacts whose time has come.
    pub(super) async fn discard_replaced(&self, now_ms: i64) -> Result<(), StoreError> {
        for key in self.replaced_artifacts.due(now_ms) {
            self.artifacts.discard(&key).await?;
            self.replaced_artifacts.lock().retain(|(_, other)| *other != key);
            tracing::info!(key, "removed a replaced file of a model");
            self.prune_folder_of(&key).await?;
        }
        Ok(())
    }

    /// Removes the folders of the versions of a model that are empty. `key` is that of a file of the model.
    pub(super) async fn prune_folder_of(&self, key: &str) -> Result<(), StoreError> {
        let Some(model) = model_of(key).filter(|_| is_key(key)) else { return Ok(()) };
        let folder = self.artifacts.local_path(&format!("{MODELS}/{model}"));
        Ok(tokio::task::spawn_blocking(move || prune(&folder)).await.map_err(std::io::Error::other)??)
    }
}
