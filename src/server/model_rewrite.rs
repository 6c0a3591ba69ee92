//! Writes changed files of a model and replaces the old ones.

use crate::server::app::AppState;
use crate::server::keyed_locks::KeyGuard;
use crate::server::memory::{MemoryPermit, rewrite_bytes};
use crate::server::models::MODEL_FILE;
use crate::server::problem::Problem;
use crate::store::{ModelFile, ModelRecord, ModelReplacement, Store, StoreError};
use relume_api::TenantId;
use relume_capture::formats::{model_file, ply_model};
use relume_scene::Model;

/// Name of the file for other programs.
const PLY_FILE: &str = "model.ply";

/// A model whose files are replaced.
pub(super) struct ModelRewrite {
    pub(super) tenant: TenantId,
    /// The model. It is read while `held` is held.
    pub(super) model: ModelRecord,
    /// The lock that prevents other changes of its files.
    pub(super) held: KeyGuard,
}

/// The changed files of a model.
struct Changed {
    card: serde_json::Value,
    /// By name.
    files: Vec<(&'static str, Vec<u8>)>,
    _memory: MemoryPermit,
}

/// Applies `change` to a model and replaces its files. From the card only the entry `calibration` is taken over. A server that ends
/// in between, or a caller that does not wait, leaves the old model or the new one.
///
/// # Errors
/// The error of `change`. When the files cannot be stored or the database fails; 404 or 409 if the model was deleted or replaced in
/// the meantime.
pub(super) async fn rewrite(
    app: &AppState,
    rewrite: ModelRewrite,
    change: impl FnOnce(&mut Model) -> Result<(), Problem> + Send + 'static,
) -> Result<(), Problem> {
    let old = app.store.model_files(&rewrite.tenant, &rewrite.model.id).await?;
    let changed = changed(app, &rewrite, change).await?;
    // Both versions are on the disk for a while; the quota of the tenant counts one of them.
    app.store.admit_bytes(changed.files.iter().map(|(_, bytes)| bytes.len() as u64).sum()).await?;
    let app = app.clone();
    // The caller may no longer wait; the files are replaced or removed nevertheless.
    let replaced = tokio::spawn(async move { replace(&app, rewrite, old, changed).await });
    replaced.await.map_err(Problem::internal)?
}

/// Reads, changes and encodes the model on the threads of uploads.
async fn changed(
    app: &AppState,
    ModelRewrite { tenant, model, .. }: &ModelRewrite,
    change: impl FnOnce(&mut Model) -> Result<(), Problem> + Send + 'static,
) -> Result<Changed, Problem> {
    let missing = || Problem::not_found("model", model.id.as_str());
    let file = app.store.verified_model_file(tenant, &model.id, MODEL_FILE).await?.ok_or_else(missing)?;
    let memory = app.memory.reserve(rewrite_bytes(u64::try_from(file.bytes).unwrap_or(0))).await?;
    let (path, mut card) = (app.store.artifacts().local_path(&file.artifact), model.card.clone());
    let work = move || {
        let bytes = std::fs::read(&path).map_err(Problem::storage_failed)?;
        let mut model = model_file::decode(&bytes).map_err(Problem::internal)?;
        drop(bytes);
        change(&mut model)?;
        take_calibration(&mut card, &model.card);
        let encoded = model_file::encode(&model).map_err(Problem::internal)?;
        let files = vec![(MODEL_FILE, encoded), (PLY_FILE, ply_model::encode(&model))];
        Ok(Changed { card, files, _memory: memory })
    };
    app.decoders.run(tenant, work).await?
}

/// Copies the entry `calibration` from the card in the model file to `card`, the card in the database. The other entries stay: the card in
/// the file has no figures of the finished training.
fn take_calibration(card: &mut serde_json::Value, of_file: &serde_json::Value) {
    let Some(fields) = card.as_object_mut() else { return };
    match of_file.get("calibration") {
        Some(calibration) => fields.insert("calibration".to_owned(), calibration.clone()),
        None => fields.remove("calibration"),
    };
}

/// Stores the files, then names them in one transaction.
async fn replace(
    app: &AppState,
    ModelRewrite { tenant, model, held }: ModelRewrite,
    old: Vec<ModelFile>,
    Changed { card, files, _memory }: Changed,
) -> Result<(), Problem> {
    let _until_replaced = held;
    let version: String = app.jobs.fresh_id();
    let mut pairs = Vec::new();
    for (name, bytes) in files {
        let Some(old) = old.iter().find(|file| file.name == name) else { continue };
        let artifact = Store::model_artifact(&model.id, &version, name);
        let size = bytes.len();
        match app.store.artifacts().put(&artifact, bytes).await {
            Ok(sha256) => {
                let bytes = i64::try_from(size).unwrap_or(i64::MAX);
                pairs.push((old.clone(), ModelFile { sha256, bytes, artifact, ..old.clone() }));
            }
            Err(error) => {
                discard(app, &pairs).await;
                return Err(shortage(app, error, size as u64));
            }
        }
    }
    match app.store.replace_model(&tenant, &model.id, &card, &pairs, app.jobs.now_ms()).await {
        Ok(ModelReplacement::Done(exports)) => {
            tracing::info!(model = %model.id, "replaced the files of a model");
            app.exports.begin_again(&exports);
            app.thumbnails.forget_all_of(model.id.as_str()).await;
            Ok(())
        }
        Ok(ModelReplacement::Outdated) => {
            discard(app, &pairs).await;
            Err(outdated(app, &tenant, &model).await)
        }
        Err(error @ StoreError::Full) => {
            discard(app, &pairs).await;
            Err(shortage(app, error, 1))
        }
        // The transaction may have succeeded. The next start removes the files if it has not.
        Err(error) => Err(error.into()),
    }
}

/// Removes new files that no row names.
async fn discard(app: &AppState, pairs: &[(ModelFile, ModelFile)]) {
    for (_, new) in pairs {
        app.store.artifacts().remove(&new.artifact).await;
    }
}

fn shortage(app: &AppState, error: StoreError, bytes: u64) -> Problem {
    if matches!(error, StoreError::Full) {
        app.store.disk_space().note_shortage(bytes);
    }
    error.into()
}

async fn outdated(app: &AppState, tenant: &TenantId, model: &ModelRecord) -> Problem {
    match app.store.model(tenant, &model.id).await {
        Ok(Some(_)) => Problem::conflict(
            "model-changed",
            "another server has changed the files of the model; send the request again",
        ),
        Ok(None) => Problem::not_found("model", model.id.as_str()),
        Err(error) => error.into(),
    }
}
