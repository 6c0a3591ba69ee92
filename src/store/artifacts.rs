//! Artifacts: immutable bytes under keys, fsynced and hashed as they stream in.
//!
//! Nothing is written in place. Bytes are written under `incoming/`, which only the running server uses, and are moved
//! to their key when they are complete. Files that the server did not write are not touched.

use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use futures::stream::BoxStream;
use futures::{StreamExt, TryStreamExt};
use object_store::local::LocalFileSystem;
use object_store::path::Path as Key;
use object_store::{GetOptions, GetRange, ObjectStore, ObjectStoreExt, PutPayload};
use sha2::{Digest, Sha256};
use tokio_util::bytes::Bytes;

use crate::store::StoreError;
use crate::store::hash::hex;
use crate::store::incoming::{INCOMING, Incoming};
use crate::store::verification::Verification;

/// The artifact store of one data directory.
#[derive(Clone)]
pub struct Artifacts {
    files: Arc<LocalFileSystem>,
    root: PathBuf,
    verification: Verification,
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
        Ok(Self { files: Arc::new(files), root, verification: Verification::default() })
    }

    /// Removes what uploads of a server that died left under `incoming/`. The caller must hold the node lock.
    ///
    /// # Errors
    /// When a left-over cannot be removed.
    pub fn sweep_incoming(&self) -> Result<(), StoreError> {
        match std::fs::remove_dir_all(self.incoming()) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error.into()),
            _ => Ok(()),
        }
    }

    /// Moves a complete upload to its key. Content-addressed keys may exist already: the bytes are the same.
    ///
    /// # Errors
    /// When the move fails; the upload is then deleted.
    pub async fn publish(&self, mut incoming: Incoming, key: &str) -> Result<(), StoreError> {
        self.files.rename(&incoming.key, &Key::from(key)).await?;
        incoming.published = true;
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
        self.files.put(&Key::from(key), PutPayload::from(bytes)).await?;
        Ok(sha256)
    }

    /// Compares an artifact with the hash it was stored under. The file is read once a process, and again when it changed.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] when they differ, [`StoreError::Missing`] when there is none.
    pub async fn verify(&self, key: &str, sha256: &str) -> Result<(), StoreError> {
        self.verification.check(key, &self.local_path(key), sha256).await
    }

    /// Reads a whole artifact.
    ///
    /// # Errors
    /// [`StoreError::Missing`] when there is none.
    pub async fn get(&self, key: &str) -> Result<Bytes, StoreError> {
        Ok(self.files.get(&Key::from(key)).await?.bytes().await?)
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
        let options = GetOptions { range: Some(GetRange::Bounded(range)), ..GetOptions::default() };
        let result = self.files.get_opts(&Key::from(key), options).await?;
        Ok(result.into_stream().map_err(StoreError::from).boxed())
    }

    /// Removes an artifact that nothing refers to; that it is missing already is no error.
    pub async fn remove(&self, key: &str) {
        self.verification.forget(key);
        if let Err(error) = self.files.delete(&Key::from(key)).await {
            tracing::debug!(%error, key, "an artifact was not removed");
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
        self.verification.forget(key);
        // Not through the object store: it has no name for a file that it had not written to the end.
        match tokio::fs::remove_file(self.local_path(key)).await {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error.into()),
            _ => Ok(()),
        }
    }

    /// The files themselves.
    pub(super) fn files(&self) -> &LocalFileSystem {
        &self.files
    }

    /// The folder of uploads in progress.
    pub(super) fn incoming(&self) -> PathBuf {
        self.root.join(INCOMING)
    }

    /// The path of an artifact on this machine.
    pub fn local_path(&self, key: &str) -> PathBuf {
        self.root.join(key)
    }
}

/// Whether `key` stays within the folder of artifacts.
pub(super) fn is_key(key: &str) -> bool {
    !key.is_empty() && Path::new(key).components().all(|part| matches!(part, Component::Normal(_)))
}
