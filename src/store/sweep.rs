//! Artifacts that nothing refers to: what a server that died while it wrote has left.

use std::collections::HashSet;
use std::fs::File;
use std::path::Path;
use std::time::{Duration, SystemTime};

use crate::store::exports::EXPORTS;
use crate::store::references::{references, stored};
use crate::store::sql;
use crate::store::uploads::UPLOADS;
use crate::store::{Store, StoreError};

/// Where artifacts go that the database knows nothing of.
pub(super) const ORPHANS: &str = "orphans";
/// How long they stay there.
pub(super) const KEEP: Duration = Duration::from_secs(7 * 24 * 3600);

/// What a sweep did.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Swept {
    /// Files that were removed.
    pub removed: usize,
    /// Files that were set aside.
    pub set_aside: usize,
}

impl Store {
    /// Removes what attempts of known jobs, uploads that ended and exports left, and sets aside for a week what the database knows nothing of: it may be an old
    /// copy. Files with names that this program does not give are not touched. The caller must hold the node lock.
    ///
    /// # Errors
    /// When the database or a file operation fails.
    pub async fn sweep_orphans(&self, now: SystemTime) -> Result<Swept, StoreError> {
        let named: HashSet<String> =
            references(self.pool()).await?.into_iter().map(|reference| reference.artifact).collect();
        let jobs: Vec<String> = sql::query_scalar("SELECT id FROM jobs").fetch_all(self.pool()).await?;
        let jobs: HashSet<String> = jobs.into_iter().collect();
        let root = self.artifacts.local_path("");
        let swept = tokio::task::spawn_blocking(move || sweep(&root, &named, &jobs, now)).await;
        self.clear_export_folders().await?;
        Ok(swept.map_err(std::io::Error::other)??)
    }
}

fn sweep(
    root: &Path,
    named: &HashSet<String>,
    jobs: &HashSet<String>,
    now: SystemTime,
) -> std::io::Result<Swept> {
    let mut swept = Swept::default();
    for key in stored(root)?.into_iter().filter(|key| !named.contains(key)) {
        let path = root.join(&key);
        let job = key.strip_prefix("attempts/").and_then(|rest| rest.split('/').next());
        let can_be_had_again = key.starts_with(UPLOADS) || key.starts_with(EXPORTS);
        if can_be_had_again || job.is_some_and(|job| jobs.contains(job)) {
            tracing::info!(key, "removed what an attempt, an upload or an export left");
            std::fs::remove_file(&path)?;
            swept.removed += 1;
        } else {
            tracing::warn!(key, "set aside a file that the database does not know");
            set_aside(&path, &root.join(ORPHANS).join(&key), now)?;
            swept.set_aside += 1;
        }
    }
    swept.removed += expire(&root.join(ORPHANS), now)?;
    prune(&root.join("attempts"))?;
    prune(&root.join(UPLOADS))?;
    prune(&root.join(EXPORTS))?;
    Ok(swept)
}

/// Moves a file; its time of modification is that of the move from then on.
fn set_aside(from: &Path, to: &Path, now: SystemTime) -> std::io::Result<()> {
    if let Some(folder) = to.parent() {
        std::fs::create_dir_all(folder)?;
    }
    File::options().write(true).open(from)?.set_modified(now)?;
    std::fs::rename(from, to)?;
    // Where both were names of one file already, a rename leaves both: a capture of an upload that was set aside before.
    match std::fs::remove_file(from) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// Removes the files that were set aside long ago.
fn expire(folder: &Path, now: SystemTime) -> std::io::Result<usize> {
    let mut removed = 0;
    for entry in entries(folder)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            removed += expire(&entry.path(), now)?;
        } else if now.duration_since(entry.metadata()?.modified()?).is_ok_and(|age| age > KEEP) {
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

/// What is in a folder; nothing when it is not there.
fn entries(folder: &Path) -> std::io::Result<impl Iterator<Item = std::io::Result<std::fs::DirEntry>>> {
    match std::fs::read_dir(folder) {
        Ok(entries) => Ok(Some(entries).into_iter().flatten()),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None.into_iter().flatten()),
        Err(error) => Err(error),
    }
}
