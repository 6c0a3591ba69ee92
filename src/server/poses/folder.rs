//! The work folders of COLMAP in the data directory: one for each capture that is being made.

use std::collections::HashSet;
use std::io;
use std::path::{Path, PathBuf};

use crate::store::{Store, StoreError};
use relume_api::CaptureId;

/// The parent of all work folders.
const FOLDER: &str = "poses";
/// The output of COLMAP.
pub(super) const LOG: &str = "colmap.log";

/// The work folder of a capture.
pub(super) fn of(store: &Store, id: &CaptureId) -> PathBuf {
    store.root().join(FOLDER).join(id.as_str())
}

/// Removes the work folder of a capture; after a failure, everything except the log, which can still be read.
pub(in crate::server) async fn clean_up(store: &Store, id: &CaptureId, failed: bool) {
    let folder = of(store, id);
    let kept = failed && matches!(tokio::task::spawn_blocking(move || keep_log(&folder)).await, Ok(Ok(())));
    if !kept {
        remove_folder(store, id).await;
    }
}

/// Removes everything except the log.
fn keep_log(folder: &Path) -> io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            std::fs::remove_dir_all(path)?;
        } else if path.file_name().is_none_or(|name| name != LOG) {
            std::fs::remove_file(path)?;
        }
    }
    Ok(())
}

/// Removes the work folder of a capture. A missing folder is not an error.
pub(in crate::server) async fn remove_folder(store: &Store, id: &CaptureId) {
    let folder = of(store, id);
    let removed = tokio::task::spawn_blocking(move || remove(&folder)).await;
    if let Err(error) = removed.unwrap_or_else(|error| Err(io::Error::other(error))) {
        tracing::warn!(%error, capture = %id, "cannot remove the work folder of COLMAP yet");
    }
}

/// Removes the work folders of captures that are no longer being made.
///
/// # Errors
/// When the database fails.
pub(in crate::server) async fn remove_leftovers(store: &Store) -> Result<(), StoreError> {
    let root = store.root().join(FOLDER);
    // The folders are listed before the database is queried, so the work folder of a later capture is not in the list.
    let found = match std::fs::read_dir(&root) {
        Ok(entries) => entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(error.into()),
    };
    let found: Vec<String> = found.collect();
    let unfinished_captures: HashSet<String> = store.unfinished_captures().await?;
    for name in found.into_iter().filter(|name| !unfinished_captures.contains(name)) {
        remove_folder(store, &name.into()).await;
    }
    Ok(())
}

/// Removes a folder. A missing folder is not an error.
fn remove(folder: &Path) -> io::Result<()> {
    match std::fs::remove_dir_all(folder) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}
