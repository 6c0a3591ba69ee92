//! The folders that COLMAP works in: one for each capture that is being made, in the data directory.

use std::collections::HashSet;
use std::io;
use std::path::{Path, PathBuf};

use crate::store::{Store, StoreError};
use relume_api::CaptureId;

/// The folder of all of them.
const FOLDER: &str = "poses";
/// COLMAP's output.
pub(super) const LOG: &str = "colmap.log";

/// Where poses are found for a capture.
pub(super) fn of(store: &Store, id: &CaptureId) -> PathBuf {
    store.root().join(FOLDER).join(id.as_str())
}

/// Removes what was needed to make a capture: all of it, but for the log where none could be made and somebody may read why.
pub(in crate::server) async fn clean_up(store: &Store, id: &CaptureId, failed: bool) {
    let folder = of(store, id);
    let kept = failed && matches!(tokio::task::spawn_blocking(move || keep_log(&folder)).await, Ok(Ok(())));
    if !kept {
        remove_folder(store, id).await;
    }
}

/// Leaves nothing but the log.
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

/// Removes the folder of a capture; that there is none is no error.
pub(in crate::server) async fn remove_folder(store: &Store, id: &CaptureId) {
    let folder = of(store, id);
    let removed = tokio::task::spawn_blocking(move || remove(&folder)).await;
    if let Err(error) = removed.unwrap_or_else(|error| Err(io::Error::other(error))) {
        tracing::warn!(%error, capture = %id, "what COLMAP left is removed later");
    }
}

/// Removes the folders of captures that are not being made any longer.
///
/// # Errors
/// When the database fails.
pub(in crate::server) async fn remove_leftovers(store: &Store) -> Result<(), StoreError> {
    let root = store.root().join(FOLDER);
    // Listed before the database is asked: what is entered later has no folder yet.
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

/// Removes a folder; that there is none is no error.
fn remove(folder: &Path) -> io::Result<()> {
    match std::fs::remove_dir_all(folder) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}
