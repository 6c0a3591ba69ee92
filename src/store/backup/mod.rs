//! Backups of a data directory, made while a server works, and data directories made from them.

mod files;
mod make;
mod manifest;
mod restore;

use files::CopiedFile;

pub use make::{backup, backup_with};
pub use restore::restore;

/// What was copied.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Backup {
    /// Artifacts.
    pub artifacts: usize,
    /// Bytes of the database and the artifacts.
    pub bytes: u64,
    /// Jobs whose checkpoints were replaced faster than they could be copied; they start over.
    pub without_checkpoint: usize,
}

impl Backup {
    fn of(database: &CopiedFile, artifacts: &[CopiedFile], without_checkpoint: usize) -> Self {
        let bytes = database.bytes + artifacts.iter().map(|file| file.bytes).sum::<u64>();
        Self { artifacts: artifacts.len(), bytes, without_checkpoint }
    }
}
