//! Verification of stored bytes by their hashes. A file is hashed once per process, and again if the file system reports a
//! change.

use std::collections::HashMap;
use std::fs::{File, Metadata};
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use crate::store::StoreError;
use crate::store::hash::hash_file;

/// Identifies the content of a file without reading it: size, modification time in ns, and inode.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct FileFingerprint(u64, i64, i64, u64);

impl FileFingerprint {
    fn of(file: &Metadata) -> Self {
        Self(file.size(), file.mtime(), file.mtime_nsec(), file.ino())
    }
}

/// The hash of a file and its fingerprint at that time. The lock is held while the file is hashed, so that concurrent readers
/// hash it only once.
type CachedHash = Arc<tokio::sync::Mutex<Option<(FileFingerprint, String)>>>;

/// The hashes of files that this process has read.
#[derive(Clone, Default)]
pub(super) struct Verification {
    files: Arc<Mutex<HashMap<String, CachedHash>>>,
}

impl Verification {
    /// Compares the hash of an artifact's file with its stored hash.
    pub(super) async fn check(&self, key: &str, path: &Path, sha256: &str) -> Result<(), StoreError> {
        let known = self.lock().entry(key.to_owned()).or_default().clone();
        let mut known = known.lock().await;
        let stamp = FileFingerprint::of(&tokio::fs::metadata(path).await.map_err(|e| absent(e, key))?);
        if known.as_ref().is_none_or(|(then, _)| *then != stamp) {
            let path = path.to_owned();
            let hashed =
                tokio::task::spawn_blocking(move || hash(&path)).await.map_err(std::io::Error::other)?;
            *known = Some(hashed.map_err(|e| absent(e, key))?);
        }
        match &*known {
            Some((_, actual)) if actual == sha256 => Ok(()),
            _ => {
                tracing::error!(key, sha256, "an artifact is damaged");
                Err(StoreError::Damaged(key.to_owned()))
            }
        }
    }

    /// Records the hash of a file that was hashed while it was written.
    pub(super) async fn learn(&self, key: &str, path: &Path, sha256: &str) -> Result<(), StoreError> {
        let known = self.lock().entry(key.to_owned()).or_default().clone();
        let mut known = known.lock().await;
        let stamp = FileFingerprint::of(&tokio::fs::metadata(path).await?);
        *known = Some((stamp, sha256.to_owned()));
        Ok(())
    }

    /// Removes the hash of a removed file.
    pub(super) fn forget(&self, key: &str) {
        self.lock().remove(key);
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, HashMap<String, CachedHash>> {
        self.files.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn absent(error: std::io::Error, key: &str) -> StoreError {
    match error.kind() {
        std::io::ErrorKind::NotFound => StoreError::Missing(key.to_owned()),
        _ => error.into(),
    }
}

/// The hash of a file, and its fingerprint before reading, so that a concurrent change is detected by the next check.
fn hash(path: &Path) -> std::io::Result<(FileFingerprint, String)> {
    let mut file = File::open(path)?;
    let stamp = FileFingerprint::of(&file.metadata()?);
    Ok((stamp, hash_file(&mut file)?))
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, SystemTime};

    use sha2::{Digest, Sha256};

    use super::*;
    use crate::store::hash::hex;

    #[tokio::test]
    async fn a_file_is_hashed_again_only_after_it_changed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, "as it was").unwrap();
        let sha256 = hex(&Sha256::digest("as it was"));
        let verification = Verification::default();
        verification.check("key", &path, &sha256).await.unwrap();

        // Other bytes with the same fingerprint are not detected, because the file is not read again.
        let time = std::fs::metadata(&path).unwrap().modified().unwrap();
        let overwrite = |bytes: &str, time: SystemTime| {
            std::fs::write(&path, bytes).unwrap();
            File::options().write(true).open(&path).unwrap().set_modified(time).unwrap();
        };
        overwrite("as it wOs", time);
        verification.check("key", &path, &sha256).await.unwrap();
        // With another fingerprint they are detected each time.
        overwrite("as it wOs", time + Duration::from_secs(1));
        for _ in 0..2 {
            let damaged = verification.check("key", &path, &sha256).await;
            assert!(matches!(damaged, Err(StoreError::Damaged(key)) if key == "key"));
        }
        overwrite("as it was", time + Duration::from_secs(2));
        verification.check("key", &path, &sha256).await.unwrap();
        std::fs::remove_file(&path).unwrap();
        assert!(matches!(verification.check("key", &path, &sha256).await, Err(StoreError::Missing(_))));
    }
}
