//! Artifacts: immutable bytes under keys, fsynced and hashed as they stream in.
//!
//! Nothing is written in place. Bytes are written under `incoming/`, which only the running server uses, and are moved
//! to their key when they are complete. Files that the server did not write are not touched.

use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use futures::stream::BoxStream;
use futures::{Stream, StreamExt, TryStreamExt};
use object_store::local::LocalFileSystem;
use object_store::path::Path as Key;
use object_store::{GetOptions, GetRange, ObjectStore, ObjectStoreExt, PutPayload, WriteMultipart};
use sha2::{Digest, Sha256};
use tokio_util::bytes::Bytes;

use crate::store::StoreError;
use crate::store::hash::hex;
use crate::store::verification::Verification;

const INCOMING: &str = "incoming";

/// The artifact store of one data directory.
#[derive(Clone)]
pub struct Artifacts {
    files: Arc<LocalFileSystem>,
    root: PathBuf,
    verification: Verification,
}

/// A complete upload that has no key yet. It is deleted when dropped unless it was published.
#[derive(Debug)]
pub struct Incoming {
    key: Key,
    published: bool,
    /// The file on this machine.
    pub path: PathBuf,
    /// Hash of the bytes, lower-case hex.
    pub sha256: String,
    /// Number of bytes.
    pub bytes: u64,
}

impl Drop for Incoming {
    fn drop(&mut self) {
        if !self.published
            && let Err(error) = std::fs::remove_file(&self.path)
        {
            tracing::warn!(%error, key = %self.key, "an upload could not be discarded");
        }
    }
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

    /// Streams a body to disk, hashing it. After an error nothing of it is left.
    ///
    /// # Errors
    /// [`StoreError::TooLarge`] beyond `limit` bytes, [`StoreError::Body`] when the sender fails,
    /// [`StoreError::Full`] when the disk is full.
    pub async fn receive<E: std::fmt::Display>(
        &self,
        name: &str,
        body: impl Stream<Item = Result<Bytes, E>>,
        limit: u64,
    ) -> Result<Incoming, StoreError> {
        let key = Key::from(format!("{INCOMING}/{name}"));
        let mut upload = WriteMultipart::new(self.files.put_multipart(&key).await?);
        match copy(&mut upload, body, limit).await {
            Ok((sha256, bytes)) => {
                upload.finish().await?;
                let path = self.local_path(key.as_ref());
                Ok(Incoming { key, published: false, path, sha256, bytes })
            }
            Err(error) => {
                upload.abort().await.ok();
                Err(error)
            }
        }
    }

    /// Moves a complete upload to its key. Content-addressed keys may exist already: the bytes are the same.
    ///
    /// # Errors
    /// When the move fails; the upload is then deleted.
    pub async fn publish(&self, mut incoming: Incoming, key: &str) -> Result<(), StoreError> {
        self.files.rename(&incoming.key, &Key::from(key)).await?;
        incoming.published = true;
        Ok(())
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

/// Copies `body` into `upload`, hashing and counting.
async fn copy<E: std::fmt::Display>(
    upload: &mut WriteMultipart,
    body: impl Stream<Item = Result<Bytes, E>>,
    limit: u64,
) -> Result<(String, u64), StoreError> {
    let mut body = std::pin::pin!(body);
    let (mut hasher, mut bytes) = (Sha256::new(), 0u64);
    while let Some(chunk) = body.next().await {
        let chunk = chunk.map_err(|e| StoreError::Body(e.to_string()))?;
        bytes += chunk.len() as u64;
        if bytes > limit {
            return Err(StoreError::TooLarge { limit });
        }
        hasher.update(&chunk);
        upload.wait_for_capacity(2).await?;
        upload.put(chunk);
    }
    Ok((hex(&hasher.finalize()), bytes))
}
