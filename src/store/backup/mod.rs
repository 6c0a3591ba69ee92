//! Backups of a data directory, made while a server runs, and restoration of data directories from them.

mod files;
mod make;
mod manifest;
mod restore;

use files::CopiedFile;

pub use make::{backup, backup_with};
pub use restore::restore;

/// Summary of a backup.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Backup {
    /// Number of artifacts.
    pub artifacts: usize,
    /// Bytes of the database and the artifacts.
    pub bytes: u64,
    /// Jobs whose checkpoints were replaced before they could be copied. They restart from step 0.
    pub without_checkpoint: usize,
}

impl Backup {
    fn of(database: &CopiedFile, artifacts: &[CopiedFile], without_checkpoint: usize) -> Self {
        let bytes = database.bytes + artifacts.iter().map(|file| file.bytes).sum::<u64>();
        Self { artifacts: artifacts.len(), bytes, without_checkpoint }
    }
}
