//! Stores artifacts: immutable bytes under keys, which are hashed and fsynced while they are written.
//!
//! Files are not overwritten in place. Bytes are written under `incoming/`, which only the running server uses, and are moved to
//! their key when they are complete. Files that the server did not write are not changed.
//!
//! With an object store, the object store is authoritative and the folder is a cache: a file is sent to the object store before
//! its existence is reported, and is downloaded if there is no local copy.

mod artifact_locks;
mod cache;
mod cached_store;
mod key;
mod object_store_config;
mod remote;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use futures::stream::BoxStream;
use futures::{StreamExt, TryStreamExt};
use object_store::local::LocalFileSystem;
use object_store::path::Path as Key;
use object_store::{GetOptions, GetRange, ObjectStore, ObjectStoreExt, PutPayload};
use sha2::{Digest, Sha256};
use tokio_util::bytes::Bytes;

use crate::store::StoreError;
use crate::store::hash::hex;
use crate::store::references::of_job;
use crate::store::staged_upload::{INCOMING, StagedUpload};
use crate::store::verification::Verification;

use cached_store::CachedStore;

pub(super) use key::{is_key, is_never_uploaded};
pub use object_store_config::{ArtifactsRedirect, ArtifactsUrl, ObjectStoreConfig};
pub(super) use remote::{Remote, RemoteObject, fetch_to};

/// The artifact store of one data directory.
#[derive(Clone)]
pub struct Artifacts {
    files: Arc<LocalFileSystem>,
    root: PathBuf,
    verification: Verification,
    cached_store: Option<Arc<CachedStore>>,
}

impl Artifacts {
    /// Opens `root/artifacts`.
    ///
    /// # Errors
    /// If the directory cannot be created.
    pub fn open(root: &Path) -> Result<Self, StoreError> {
        let root = root.join("artifacts");
        std::fs::create_dir_all(&root)?;
        let files = LocalFileSystem::new_with_prefix(&root)?.with_fsync(true);
        Ok(Self { files: Arc::new(files), root, verification: Verification::default(), cached_store: None })
    }

    /// Makes the folder a cache of an object store. Sends no request yet.
    ///
    /// # Errors
    /// If a setting is missing or invalid, or if the folder cannot be read.
    pub(super) fn with_object_store(mut self, config: &ObjectStoreConfig) -> Result<Self, StoreError> {
        self.cached_store = Some(Arc::new(CachedStore::open(&self.root, config, self.verification.clone())?));
        Ok(self)
    }

    /// Removes files that uploads of a terminated server left under `incoming/`. The caller must hold the lock of the data
    /// directory.
    ///
    /// # Errors
    /// If a file cannot be removed.
    pub fn clean_up_incoming(&self) -> Result<(), StoreError> {
        match std::fs::remove_dir_all(self.incoming()) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error.into()),
            _ => Ok(()),
        }
    }

    /// Sends a complete file to the object store, if there is one, under its future key. This can take long, so the caller should
    /// hold no lock that others wait for.
    ///
    /// # Errors
    /// [`StoreError::ArtifactsUnreachable`] if it cannot be stored.
    pub(super) async fn upload_file(&self, path: &Path, key: &str) -> Result<(), StoreError> {
        match self.cached_store_for(key) {
            Some(cached_store) => cached_store.remote.put_file(key, path).await,
            None => Ok(()),
        }
    }

    /// Moves a complete upload to its key. A content-addressed key may already exist with the same bytes. A file that
    /// [`Artifacts::upload_file`] has sent is sent again only if the object store no longer has it.
    ///
    /// # Errors
    /// If the move fails. The upload is then deleted.
    pub async fn publish(&self, mut incoming: StagedUpload, key: &str) -> Result<(), StoreError> {
        // Only a key that ends with the hash identifies the content.
        let is_there = async |cached_store: &CachedStore| match key.ends_with(&incoming.sha256) {
            true => Ok::<_, StoreError>(cached_store.remote.size(key).await? == Some(incoming.bytes)),
            false => Ok(false),
        };
        if let Some(cached_store) = self.cached_store_for(key)
            && !is_there(cached_store).await?
        {
            cached_store.remote.put_file(key, &incoming.path).await?;
        }
        let _key_lock = self.key_lock(key).await;
        self.files.rename(&incoming.key, &Key::from(key)).await?;
        incoming.published = true;
        self.add_to_cache(key, incoming.bytes);
        // If both paths are links to one file, a rename keeps both.
        match tokio::fs::remove_file(&incoming.path).await {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error.into()),
            _ => Ok(()),
        }
    }

    /// Writes an artifact and returns its sha256 in hex. The artifact is durable on return.
    ///
    /// # Errors
    /// [`StoreError::Full`] if the disk is full. Then nothing is stored under `key`.
    pub async fn put(&self, key: &str, bytes: Vec<u8>) -> Result<String, StoreError> {
        let sha256 = hex(&Sha256::digest(&bytes));
        let Some(cached_store) = self.cached_store_for(key) else {
            self.files.put(&Key::from(key), PutPayload::from(bytes)).await?;
            return Ok(sha256);
        };
        let bytes = Bytes::from(bytes);
        cached_store.remote.put(key, bytes.clone()).await?;
        let size = bytes.len() as u64;
        let key_lock = self.key_lock(key).await;
        match self.files.put(&Key::from(key), PutPayload::from(bytes)).await {
            Ok(_) => self.add_to_cache(key, size),
            // The artifact is in the object store in any case.
            Err(error) => tracing::warn!(%error, key, "cannot keep a local copy of an artifact"),
        }
        drop(key_lock);
        self.trim().await;
        Ok(sha256)
    }

    /// Downloads an artifact if there is no local copy, and compares it with its stored hash. A file is read once per process,
    /// and again if it changed. The copy is kept long enough for the caller to open it.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] if the hash differs, [`StoreError::Missing`] if the artifact does not exist,
    /// [`StoreError::ArtifactsUnreachable`] if it cannot be downloaded.
    pub async fn verify(&self, key: &str, sha256: &str) -> Result<(), StoreError> {
        let path = self.local_path(key);
        let Some(cached_store) = self.cached_store_for(key) else {
            return self.verification.check(key, &path, sha256).await;
        };
        let key_lock = self.key_lock(key).await;
        match self.verification.check(key, &path, sha256).await {
            Err(StoreError::Damaged(_) | StoreError::Missing(_)) => {
                cached_store.fetch(key, sha256, &self.incoming(), &path).await?;
            }
            checked => {
                cached_store.cache.touch(key);
                return checked;
            }
        }
        drop(key_lock);
        self.trim().await;
        Ok(())
    }

    /// Reads an artifact.
    ///
    /// # Errors
    /// [`StoreError::Missing`] if it does not exist.
    pub async fn get(&self, key: &str) -> Result<Bytes, StoreError> {
        let here = async { Ok(self.files.get(&Key::from(key)).await?.bytes().await?) };
        match (here.await, self.cached_store_for(key)) {
            (Err(StoreError::Missing(_)), Some(cached_store)) => cached_store.remote.get(key).await,
            (here, _) => here,
        }
    }

    /// A URL of the object store that permits reading an artifact for the duration `lasts`. `None` if callers are not redirected
    /// to the object store, or if the artifact exists only on this machine.
    ///
    /// # Errors
    /// [`StoreError::ArtifactsUnreachable`] if the credentials are not available.
    pub async fn signed_url(&self, key: &str, lasts: Duration) -> Result<Option<String>, StoreError> {
        match self.cached_store_for(key) {
            Some(cached_store) if !cached_store.cache.is_local_only(key) => {
                cached_store.remote.signed(key, lasts).await
            }
            _ => Ok(None),
        }
    }

    /// Streams bytes `range` of an artifact.
    ///
    /// # Errors
    /// [`StoreError::Missing`] if it does not exist.
    pub async fn stream(
        &self,
        key: &str,
        range: std::ops::Range<u64>,
    ) -> Result<BoxStream<'static, Result<Bytes, StoreError>>, StoreError> {
        if range.is_empty() {
            return Ok(futures::stream::empty().boxed());
        }
        let options = GetOptions { range: Some(GetRange::Bounded(range.clone())), ..GetOptions::default() };
        let here = self.files.get_opts(&Key::from(key), options).await.map_err(StoreError::from);
        match (here, self.cached_store_for(key)) {
            (Err(StoreError::Missing(_)), Some(cached_store)) => cached_store.remote.stream(key, range).await,
            (here, _) => Ok(here?.into_stream().map_err(StoreError::from).boxed()),
        }
    }

    /// The size of an artifact; `None` if it does not exist.
    ///
    /// # Errors
    /// [`StoreError::ArtifactsUnreachable`] if there is no local copy and the object store cannot be reached.
    pub async fn size(&self, key: &str) -> Result<Option<u64>, StoreError> {
        match (tokio::fs::metadata(self.local_path(key)).await, self.cached_store_for(key)) {
            (Ok(file), _) => Ok(Some(file.len())),
            (Err(_), Some(cached_store)) => cached_store.remote.size(key).await,
            (Err(_), None) => Ok(None),
        }
    }

    /// Removes an artifact without references. A missing artifact is not an error.
    pub async fn remove(&self, key: &str) {
        let _key_lock = self.key_lock(key).await;
        self.forget(key);
        if let Err(error) = self.files.delete(&Key::from(key)).await {
            tracing::debug!(%error, key, "cannot remove an artifact");
        }
        if let Some(cached_store) = self.cached_store_for(key)
            && let Err(error) = cached_store.remote.remove(key).await
        {
            tracing::warn!(%error, key, "cannot remove an artifact from the object store; the next start removes it");
        }
    }

    /// Removes an artifact permanently. A missing artifact is not an error.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] for an invalid key. A database from another source may contain such a key, and its path may lead
    /// out of the store.
    pub(super) async fn discard(&self, key: &str) -> Result<(), StoreError> {
        if !is_key(key) {
            return Err(StoreError::Damaged(key.to_owned()));
        }
        if let Some(cached_store) = self.cached_store_for(key) {
            cached_store.remote.remove(key).await?;
        }
        let _key_lock = self.key_lock(key).await;
        self.forget(key);
        // The object store has no key for a file that was not written completely.
        match tokio::fs::remove_file(self.local_path(key)).await {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error.into()),
            _ => Ok(()),
        }
    }

    /// Removes excess local copies. A copy that cannot be removed now is removed later.
    pub async fn trim(&self) {
        let Some(cached_store) = &self.cached_store else { return };
        for key in cached_store.cache.evictable() {
            if let Err(error) = cached_store.drop_copy(&key, &self.local_path(&key)).await {
                tracing::warn!(%error, key, "a local copy of an artifact cannot be removed yet");
            }
        }
    }

    /// Checks that the object store answers, if there is one.
    ///
    /// # Errors
    /// [`StoreError::ArtifactsUnreachable`] if it does not answer.
    pub async fn ping(&self) -> Result<(), StoreError> {
        match &self.cached_store {
            Some(cached_store) => cached_store.remote.ping().await,
            None => Ok(()),
        }
    }

    /// The object store, if there is one.
    pub(super) fn remote(&self) -> Option<&Remote> {
        self.cached_store.as_deref().map(|cached_store| &cached_store.remote)
    }

    /// The local files.
    pub(super) fn files(&self) -> &LocalFileSystem {
        &self.files
    }

    /// The folder of staged uploads.
    pub(super) fn incoming(&self) -> PathBuf {
        self.root.join(INCOMING)
    }

    /// The local path of an artifact. It is valid after [`Artifacts::verify`], and for artifacts that are never sent to the
    /// object store.
    pub fn local_path(&self, key: &str) -> PathBuf {
        self.root.join(key)
    }

    /// Sends a file that only this machine has to the object store; `false` for a file that is never sent.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] if its hash differs from the stored hash; [`StoreError::ArtifactsUnreachable`].
    pub(super) async fn upload_local(&self, key: &str, sha256: Option<&str>) -> Result<bool, StoreError> {
        let Some(cached_store) = self.cached_store_for(key) else { return Ok(false) };
        let (path, _key_lock) = (self.local_path(key), self.key_lock(key).await);
        if let Some(sha256) = sha256 {
            self.verification.check(key, &path, sha256).await?;
        }
        cached_store.remote.put_file(key, &path).await?;
        cached_store.cache.is_in_object_store(key);
        Ok(true)
    }

    /// The keys of all files that attempts of a job wrote, on this machine and in the object store.
    ///
    /// # Errors
    /// If the folder cannot be read or the object store cannot be reached.
    pub(super) async fn of_job(&self, job: &str) -> Result<Vec<String>, StoreError> {
        let (root, id) = (self.root.clone(), job.to_owned());
        let here = tokio::task::spawn_blocking(move || of_job(&root, &id)).await;
        let mut keys = here.map_err(std::io::Error::other)??;
        if let Some(cached_store) = &self.cached_store {
            let there = cached_store.remote.list(&format!("attempts/{job}")).await?;
            keys.extend(there.into_iter().map(|object| object.key));
            keys.sort();
            keys.dedup();
        }
        Ok(keys)
    }

    /// Records that the object store has this file.
    pub(super) fn is_in_object_store(&self, key: &str) {
        if let Some(cached_store) = self.cached_store_for(key) {
            cached_store.cache.is_in_object_store(key);
        }
    }

    /// Records that a file that was written here is also in the object store.
    pub(super) fn add_to_cache(&self, key: &str, bytes: u64) {
        if let Some(cached_store) = self.cached_store_for(key) {
            cached_store.cache.add(key, bytes);
        }
    }

    fn forget(&self, key: &str) {
        self.verification.forget(key);
        if let Some(cached_store) = self.cached_store_for(key) {
            cached_store.cache.forget(key);
        }
    }

    /// Prevents other tasks from writing or removing the copy of `key`.
    async fn key_lock(&self, key: &str) -> Option<tokio::sync::OwnedMutexGuard<()>> {
        match self.cached_store_for(key) {
            Some(cached_store) => Some(cached_store.artifact_locks.take(key).await),
            None => None,
        }
    }

    fn cached_store_for(&self, key: &str) -> Option<&CachedStore> {
        self.cached_store.as_deref().filter(|_| !is_never_uploaded(key))
    }
}
