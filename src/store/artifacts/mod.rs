//! Artifacts: immutable bytes under keys, fsynced and hashed as they stream in.
//!
//! Nothing is written in place. Bytes are written under `incoming/`, which only the running server uses, and are moved
//! to their key when they are complete. Files that the server did not write are not touched.
//!
//! With an object store that one has what is stored, and the folder is a cache of it: a file is sent there before anybody is told
//! of it, and fetched from there when it is not here.

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
    /// When the directory cannot be made.
    pub fn open(root: &Path) -> Result<Self, StoreError> {
        let root = root.join("artifacts");
        std::fs::create_dir_all(&root)?;
        let files = LocalFileSystem::new_with_prefix(&root)?.with_fsync(true);
        Ok(Self { files: Arc::new(files), root, verification: Verification::default(), cached_store: None })
    }

    /// The same folder as a cache of an object store. Nothing is asked of that yet.
    ///
    /// # Errors
    /// When a setting of it is missing or wrong, or the folder cannot be read.
    pub(super) fn with_object_store(mut self, config: &ObjectStoreConfig) -> Result<Self, StoreError> {
        self.cached_store = Some(Arc::new(CachedStore::open(&self.root, config, self.verification.clone())?));
        Ok(self)
    }

    /// Removes what uploads of a server that died left under `incoming/`. The caller must hold the node lock.
    ///
    /// # Errors
    /// When a left-over cannot be removed.
    pub fn clean_up_incoming(&self) -> Result<(), StoreError> {
        match std::fs::remove_dir_all(self.incoming()) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error.into()),
            _ => Ok(()),
        }
    }

    /// Sends a complete file to the object store, if there is one, under the key that it is about to get. May take long: nothing that
    /// others wait for should be held meanwhile.
    ///
    /// # Errors
    /// [`StoreError::ArtifactsUnreachable`] when it cannot be stored.
    pub(super) async fn upload_file(&self, path: &Path, key: &str) -> Result<(), StoreError> {
        match self.cached_store_for(key) {
            Some(cached_store) => cached_store.remote.put_file(key, path).await,
            None => Ok(()),
        }
    }

    /// Moves a complete upload to its key. Content-addressed keys may exist already: the bytes are the same. What
    /// [`Artifacts::upload_file`] has sent is not sent again, unless somebody has removed it since.
    ///
    /// # Errors
    /// When the move fails; the upload is then deleted.
    pub async fn publish(&self, mut incoming: StagedUpload, key: &str) -> Result<(), StoreError> {
        // Only a key that is made of the hash says what is there.
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
        // Where both were names of one file already, a rename leaves both.
        match tokio::fs::remove_file(&incoming.path).await {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error.into()),
            _ => Ok(()),
        }
    }

    /// Writes a whole artifact and returns its sha256 in hex; durable when it returns.
    ///
    /// # Errors
    /// [`StoreError::Full`] when the disk is full; nothing is at `key` then.
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
            // It is stored all the same.
            Err(error) => tracing::warn!(%error, key, "no copy of an artifact is kept on this machine"),
        }
        drop(key_lock);
        self.trim().await;
        Ok(sha256)
    }

    /// Makes sure that an artifact is on this machine and compares it with the hash it was stored under. The file is read once a
    /// process, and again when it changed. It stays long enough to be opened.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] when they differ, [`StoreError::Missing`] when there is none,
    /// [`StoreError::ArtifactsUnreachable`] when it is elsewhere and cannot be fetched.
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

    /// Reads a whole artifact.
    ///
    /// # Errors
    /// [`StoreError::Missing`] when there is none.
    pub async fn get(&self, key: &str) -> Result<Bytes, StoreError> {
        let here = async { Ok(self.files.get(&Key::from(key)).await?.bytes().await?) };
        match (here.await, self.cached_store_for(key)) {
            (Err(StoreError::Missing(_)), Some(cached_store)) => cached_store.remote.get(key).await,
            (here, _) => here,
        }
    }

    /// A URL of the object store by which whoever has it may read an artifact for as long. `None` where callers are not sent there, and
    /// for what only this machine has.
    ///
    /// # Errors
    /// [`StoreError::ArtifactsUnreachable`] when credentials cannot be had.
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
    /// [`StoreError::Missing`] when there is none.
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

    /// The size of an artifact; `None` when there is none.
    ///
    /// # Errors
    /// [`StoreError::ArtifactsUnreachable`] when it is not here and cannot be asked for elsewhere.
    pub async fn size(&self, key: &str) -> Result<Option<u64>, StoreError> {
        match (tokio::fs::metadata(self.local_path(key)).await, self.cached_store_for(key)) {
            (Ok(file), _) => Ok(Some(file.len())),
            (Err(_), Some(cached_store)) => cached_store.remote.size(key).await,
            (Err(_), None) => Ok(None),
        }
    }

    /// Removes an artifact that nothing refers to; that it is missing already is no error.
    pub async fn remove(&self, key: &str) {
        let _key_lock = self.key_lock(key).await;
        self.forget(key);
        if let Err(error) = self.files.delete(&Key::from(key)).await {
            tracing::debug!(%error, key, "an artifact was not removed");
        }
        if let Some(cached_store) = self.cached_store_for(key)
            && let Err(error) = cached_store.remote.remove(key).await
        {
            tracing::warn!(%error, key, "an artifact stays in the object store until a server starts");
        }
    }

    /// Removes an artifact for good; that it is missing already is no error.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] for what is no key: such a name may come with a database from elsewhere, and leads out of the store.
    pub(super) async fn discard(&self, key: &str) -> Result<(), StoreError> {
        if !is_key(key) {
            return Err(StoreError::Damaged(key.to_owned()));
        }
        if let Some(cached_store) = self.cached_store_for(key) {
            cached_store.remote.remove(key).await?;
        }
        let _key_lock = self.key_lock(key).await;
        self.forget(key);
        // Not through the object store: it has no name for a file that it had not written to the end.
        match tokio::fs::remove_file(self.local_path(key)).await {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error.into()),
            _ => Ok(()),
        }
    }

    /// Removes copies that are too many. What cannot be removed now goes another time.
    pub async fn trim(&self) {
        let Some(cached_store) = &self.cached_store else { return };
        for key in cached_store.cache.evictable() {
            if let Err(error) = cached_store.drop_copy(&key, &self.local_path(&key)).await {
                tracing::warn!(%error, key, "a copy of an artifact cannot be removed yet");
            }
        }
    }

    /// Whether the object store answers, if there is one.
    ///
    /// # Errors
    /// [`StoreError::ArtifactsUnreachable`] when it does not.
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

    /// The files themselves.
    pub(super) fn files(&self) -> &LocalFileSystem {
        &self.files
    }

    /// The folder of uploads in progress.
    pub(super) fn incoming(&self) -> PathBuf {
        self.root.join(INCOMING)
    }

    /// The path of an artifact on this machine: once it was verified, and for what never leaves it.
    pub fn local_path(&self, key: &str) -> PathBuf {
        self.root.join(key)
    }

    /// Sends a file that only this machine has to the object store; `false` for one that stays here.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] when its bytes are others than were stored, [`StoreError::ArtifactsUnreachable`].
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

    /// The keys of all that attempts of a job wrote, here and elsewhere.
    ///
    /// # Errors
    /// When the folder cannot be read, or the object store not be asked.
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

    /// The object store is known to have this file.
    pub(super) fn is_in_object_store(&self, key: &str) {
        if let Some(cached_store) = self.cached_store_for(key) {
            cached_store.cache.is_in_object_store(key);
        }
    }

    /// A file that was written here is stored elsewhere, too.
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

    /// Nobody else writes or removes the copy of `key` meanwhile.
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
