//! Files and folders of backups.

use std::fs::File;
use std::io::{Read, Write};
use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::store::folder::make_private;
use crate::store::{StoreError, hex};

/// A file of a backup.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct CopiedFile {
    /// The key in the artifact store, or the name of the database.
    pub(super) key: String,
    /// Hash of its bytes, lower-case hex.
    pub(super) sha256: String,
    /// Its size.
    pub(super) bytes: u64,
}

/// Copies a file to a new file and returns its hash. The copy is durable on return. After an error nothing exists at `to`.
pub(super) fn copy(key: &str, from: &Path, to: &Path) -> std::io::Result<CopiedFile> {
    let mut source = File::open(from)?;
    if let Some(folder) = to.parent() {
        std::fs::create_dir_all(folder)?;
    }
    let mut target = File::create_new(to)?;
    let copied = stream(key, &mut source, &mut target).and_then(|file| target.sync_all().map(|()| file));
    if copied.is_err() {
        std::fs::remove_file(to)?;
    }
    copied
}

fn stream(key: &str, from: &mut File, to: &mut File) -> std::io::Result<CopiedFile> {
    let (mut hasher, mut buffer, mut bytes) = (Sha256::new(), vec![0; 1 << 20], 0);
    loop {
        let count = from.read(&mut buffer)?;
        if count == 0 {
            return Ok(CopiedFile { key: key.to_owned(), sha256: hex(&hasher.finalize()), bytes });
        }
        hasher.update(&buffer[..count]);
        to.write_all(&buffer[..count])?;
        bytes += count as u64;
    }
}

/// Makes sure that a folder exists and is empty. Creates it with access for its owner only.
///
/// # Errors
/// [`StoreError::NotEmpty`] if the folder is not empty.
pub(super) fn claim(folder: &Path) -> Result<(), StoreError> {
    make_private(folder)?;
    match std::fs::read_dir(folder)?.next() {
        None => Ok(()),
        Some(_) => Err(StoreError::NotEmpty(folder.display().to_string())),
    }
}

/// Makes the directory entries in a folder and its subfolders durable.
pub(super) fn sync_folders(folder: &Path) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            sync_folders(&entry.path())?;
        }
    }
    File::open(folder)?.sync_all()
}

/// Removes the contents of a claimed folder.
pub(super) fn clear(folder: &Path) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        let removed =
            if path.is_dir() { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) };
        if let Err(error) = removed {
            tracing::warn!(%error, path = %path.display(), "cannot remove an incomplete backup or data directory");
        }
    }
}
