//! Startup cleanup of orphans: artifacts without a reference, which a terminated server has left.

use std::collections::{HashMap, HashSet};
use std::fs::File;
use std::path::Path;
use std::time::{Duration, SystemTime};

use crate::store::exports::EXPORTS;
use crate::store::model_replacement::MODELS;
use crate::store::references::{artifact_keys, names, references};
use crate::store::uploads::UPLOADS;
use crate::store::{Store, StoreError, sql};

/// The folder of orphans that the database does not know.
pub(super) const ORPHANS: &str = "orphans";
/// Time for which orphans are kept.
pub(super) const ORPHAN_RETENTION: Duration = Duration::from_secs(7 * 24 * 3600);

/// Result of a cleanup.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct OrphanCleanup {
    /// Number of removed files.
    pub removed: usize,
    /// Number of files that were moved to the orphans folder.
    pub set_aside: usize,
}

impl Store {
    /// Removes leftover files of known jobs' attempts, of known models, of ended uploads and of exports. Moves files that the database does not
    /// know to the orphans folder for seven days, because the database may be an old copy. Keeps files that a remote worker has
    /// sent for the model that it is about to publish, and files with names that this program does not create. Does nothing if the
    /// database has never named an artifact. The caller must hold the lock of the data directory.
    ///
    /// # Errors
    /// When the database or a file operation fails.
    pub async fn clean_up_orphans(&self, now: SystemTime) -> Result<OrphanCleanup, StoreError> {
        if names(self.pool()).await?.is_empty() {
            return Ok(OrphanCleanup::default());
        }
        let named: HashSet<String> =
            references(self.pool()).await?.into_iter().map(|reference| reference.artifact).collect();
        let attempts =
            "SELECT id, CASE WHEN state IN ('running', 'cancelling') THEN attempts ELSE 0 END FROM jobs";
        let jobs: Vec<(String, i64)> = sql::query_as(attempts).fetch_all(self.pool()).await?;
        let jobs: HashMap<String, i64> = jobs.into_iter().collect();
        let models: Vec<String> = sql::query_scalar("SELECT id FROM models").fetch_all(self.pool()).await?;
        let known = Known { named, jobs, models: models.into_iter().collect() };
        let root = self.artifacts.local_path("");
        let swept = tokio::task::spawn_blocking(move || clean_up(&root, &known, now)).await;
        self.clear_export_folders().await?;
        Ok(swept.map_err(std::io::Error::other)??)
    }
}

/// What the database knows.
struct Known {
    /// The keys of artifacts that it references.
    named: HashSet<String>,
    /// The number of the running attempt of each job; 0 if none is running.
    jobs: HashMap<String, i64>,
    /// The models.
    models: HashSet<String>,
}

fn clean_up(root: &Path, known: &Known, now: SystemTime) -> std::io::Result<OrphanCleanup> {
    let mut swept = OrphanCleanup::default();
    for key in artifact_keys(root)?.into_iter().filter(|key| !known.named.contains(key)) {
        let path = root.join(&key);
        let is_of_a_model = model_of(&key).is_some_and(|model| known.models.contains(model));
        let can_be_had_again = is_of_a_model || key.starts_with(UPLOADS) || key.starts_with(EXPORTS);
        let attempt = attempt_of(&key).map(|(job, number)| (known.jobs.get(job).copied(), number));
        if let Some((Some(running), number)) = attempt
            && number == running
        {
            continue;
        }
        if can_be_had_again || matches!(attempt, Some((Some(_), _))) {
            tracing::info!(key, "removed a leftover file of an attempt, a model, an upload or an export");
            std::fs::remove_file(&path)?;
            swept.removed += 1;
        } else {
            tracing::warn!(key, "moved a file that the database does not know to the orphans folder");
            set_aside(&path, &root.join(ORPHANS).join(&key), now)?;
            swept.set_aside += 1;
        }
    }
    swept.removed += expire(&root.join(ORPHANS), now)?;
    prune(&root.join("attempts"))?;
    prune(&root.join(MODELS))?;
    prune(&root.join(UPLOADS))?;
    prune(&root.join(EXPORTS))?;
    Ok(swept)
}

/// Job and attempt number in the key of a file.
fn attempt_of(key: &str) -> Option<(&str, i64)> {
    let (job, rest) = key.strip_prefix("attempts/")?.split_once('/')?;
    // An invalid number matches no attempt.
    Some((job, rest.split('/').next()?.parse().unwrap_or(-1)))
}

/// The model in the key of a file.
pub(super) fn model_of(key: &str) -> Option<&str> {
    key.strip_prefix(MODELS)?.strip_prefix('/')?.split('/').next()
}

/// Moves a file and sets its modification time to `now`.
fn set_aside(from: &Path, to: &Path, now: SystemTime) -> std::io::Result<()> {
    if let Some(folder) = to.parent() {
        std::fs::create_dir_all(folder)?;
    }
    File::options().write(true).open(from)?.set_modified(now)?;
    std::fs::rename(from, to)?;
    // If both paths are links to one file, a rename keeps both. This occurs for a capture of an upload that was moved before.
    match std::fs::remove_file(from) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// Removes expired orphans.
fn expire(folder: &Path, now: SystemTime) -> std::io::Result<usize> {
    let mut removed = 0;
    for entry in entries(folder)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            removed += expire(&entry.path(), now)?;
        } else if now.duration_since(entry.metadata()?.modified()?).is_ok_and(|age| age > ORPHAN_RETENTION) {
            std::fs::remove_file(entry.path())?;
            removed += 1;
        }
    }
    prune(folder)?;
    Ok(removed)
}

/// Removes empty folders, innermost first.
pub(super) fn prune(folder: &Path) -> std::io::Result<()> {
    for entry in entries(folder)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            prune(&entry.path())?;
        }
    }
    match std::fs::remove_dir(folder) {
        Err(error)
            if !matches!(
                error.kind(),
                std::io::ErrorKind::DirectoryNotEmpty | std::io::ErrorKind::NotFound
            ) =>
        {
            Err(error)
        }
        _ => Ok(()),
    }
}

/// The entries of a folder; none if it does not exist.
fn entries(folder: &Path) -> std::io::Result<impl Iterator<Item = std::io::Result<std::fs::DirEntry>>> {
    match std::fs::read_dir(folder) {
        Ok(entries) => Ok(Some(entries).into_iter().flatten()),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None.into_iter().flatten()),
        Err(error) => Err(error),
    }
}
