//! Transfers between the object store and the folder that caches it.

use std::collections::HashMap;
use std::io;
use std::path::Path;

use tokio::fs::File;

use crate::store::StoreError;
use crate::store::artifacts::artifact_locks::ArtifactLocks;
use crate::store::artifacts::cache::{Cache, CachedFile};
use crate::store::artifacts::key::is_never_uploaded;
use crate::store::artifacts::object_store_config::ObjectStoreConfig;
use crate::store::artifacts::remote::Remote;
use crate::store::references::artifact_keys;
use crate::store::verification::Verification;

/// Number of downloads of a file whose hash differs from the stored hash.
const MAX_FETCHES: u32 = 2;

/// The object store and the copies on this machine.
pub(super) struct CachedStore {
    pub(super) remote: Remote,
    pub(super) cache: Cache,
    pub(super) artifact_locks: ArtifactLocks,
    verification: Verification,
}

impl CachedStore {
    /// Reads the existing files of the folder. Blocks.
    pub(super) fn open(
        folder: &Path,
        config: &ObjectStoreConfig,
        verification: Verification,
    ) -> Result<Self, StoreError> {
        let mut found = HashMap::new();
        for key in artifact_keys(folder)?.into_iter().filter(|key| !is_never_uploaded(key)) {
            let file = std::fs::metadata(folder.join(&key))?;
            let copy = CachedFile { bytes: file.len(), used: file.modified()?, is_in_object_store: false };
            found.insert(key, copy);
        }
        let cache = Cache::new(config.cache_bytes, config.cache_min_age, found);
        Ok(Self {
            remote: Remote::open(config)?,
            cache,
            artifact_locks: ArtifactLocks::default(),
            verification,
        })
    }

    /// Downloads a file to its path, through a temporary file in `folder` that is deleted if its hash differs. The caller must
    /// hold the lock of the key.
    pub(super) async fn fetch(
        &self,
        key: &str,
        sha256: &str,
        folder: &Path,
        path: &Path,
    ) -> Result<(), StoreError> {
        tokio::fs::create_dir_all(folder).await?;
        for _ in 0..MAX_FETCHES {
            let (file, temporary) =
                tempfile::Builder::new().prefix("fetched-").tempfile_in(folder)?.into_parts();
            let mut file = File::from_std(file);
            let (found, bytes) = self.remote.fetch(key, &mut file).await?;
            if found != sha256 {
                tracing::warn!(key, sha256, found, "a downloaded artifact differs from the stored one");
                continue;
            }
            if let Some(folder) = path.parent() {
                tokio::fs::create_dir_all(folder).await?;
            }
            temporary.persist(path).map_err(|error| error.error)?;
            self.verification.learn(key, path, sha256).await?;
            self.cache.add(key, bytes);
            return Ok(());
        }
        tracing::error!(key, sha256, "an artifact is damaged in the object store");
        Err(StoreError::Damaged(key.to_owned()))
    }

    /// Removes the local copy of a file that is in the object store, unless it was used in the meantime.
    pub(super) async fn drop_copy(&self, key: &str, path: &Path) -> Result<(), StoreError> {
        let _key_lock = self.artifact_locks.take(key).await;
        let Some(copy) = self.cache.idle(key) else { return Ok(()) };
        if !tokio::fs::try_exists(path).await? {
            self.cache.forget(key);
            return Ok(());
        }
        if !copy.is_in_object_store && self.remote.size(key).await? != Some(copy.bytes) {
            // This may be the only copy. The next server that starts sends referenced files to the object store.
            self.cache.touch(key);
            tracing::debug!(key, "the object store does not have this file; the local copy is kept");
            return Ok(());
        }
        self.verification.forget(key);
        self.cache.forget(key);
        match tokio::fs::remove_file(path).await {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error.into()),
            _ => Ok(()),
        }
    }
}
