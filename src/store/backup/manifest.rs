//! The list of files of a backup. The manifest is written last, so a folder without a manifest is not a complete backup.

use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::store::StoreError;
use crate::store::artifacts::is_key;
use crate::store::backup::files::{CopiedFile, sync_folders};

/// Name of the manifest in a backup.
const MANIFEST: &str = "backup.json";
/// Name of the database in a backup. It differs from a server's, so that no server starts on a backup by mistake.
pub(super) const DATABASE: &str = "backup.db";
/// Version of the layout.
const FORMAT: u32 = 1;

/// The list of a backup's files.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Manifest {
    format: u32,
    /// Version of the program that made the backup.
    version: String,
    /// Schema of the database.
    pub(super) schema: i64,
    /// Start time of the backup.
    created_at: String,
    /// The database.
    pub(super) database: CopiedFile,
    /// The artifacts that the database references.
    pub(super) artifacts: Vec<CopiedFile>,
}

impl Manifest {
    pub(super) fn new(
        schema: i64,
        created_at: String,
        database: CopiedFile,
        artifacts: Vec<CopiedFile>,
    ) -> Self {
        let version = env!("CARGO_PKG_VERSION").to_owned();
        Self { format: FORMAT, version, schema, created_at, database, artifacts }
    }

    /// Writes the manifest, which completes the backup.
    pub(super) fn write(&self, backup: &Path) -> Result<(), StoreError> {
        sync_folders(backup)?;
        let text = serde_json::to_vec_pretty(self).map_err(std::io::Error::from)?;
        let mut file = tempfile::NamedTempFile::new_in(backup)?;
        file.write_all(&text)?;
        file.as_file().sync_all()?;
        file.persist(backup.join(MANIFEST)).map_err(|error| error.error)?;
        Ok(std::fs::File::open(backup)?.sync_all()?)
    }

    /// Reads the manifest of a backup.
    ///
    /// # Errors
    /// [`StoreError::NoBackup`] if there is no manifest or it is invalid.
    pub(super) fn read(backup: &Path) -> Result<Self, StoreError> {
        let refused = |why: String| StoreError::NoBackup { path: backup.display().to_string(), why };
        let text = std::fs::read(backup.join(MANIFEST)).map_err(|error| match error.kind() {
            std::io::ErrorKind::NotFound => {
                refused(format!("it has no {MANIFEST}, which is written when a backup is complete"))
            }
            _ => error.into(),
        })?;
        let manifest: Self =
            serde_json::from_slice(&text).map_err(|error| refused(format!("{MANIFEST}: {error}")))?;
        if manifest.format != FORMAT {
            return Err(refused(format!("{MANIFEST}: format {} is not supported", manifest.format)));
        }
        match manifest.artifacts.iter().find(|file| !is_key(&file.key)) {
            Some(file) => Err(refused(format!("{MANIFEST}: {:?} is not the key of an artifact", file.key))),
            None => Ok(manifest),
        }
    }
}

/// The path of an artifact, in a backup and in a data directory.
pub(super) fn artifact_path(root: &Path, key: &str) -> PathBuf {
    root.join("artifacts").join(key)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn artifact_keys_cannot_leave_the_data_directory() {
        assert!(is_key("captures/00") && is_key("attempts/job/1/model.ply"));
        for wrong in ["", "/etc/passwd", "../x", "captures/../../x", "./x"] {
            assert!(!is_key(wrong), "{wrong:?}");
        }
    }
}
