//! The object store. Files are hashed during their transfer and never held in memory as a whole.

use std::path::Path;
use std::time::{Duration, SystemTime};

use futures::stream::BoxStream;
use futures::{StreamExt, TryStreamExt};
use object_store::path::Path as Key;
use object_store::prefix::PrefixStore;
use object_store::signer::{Method, Signer};
use object_store::{
    Error, GetOptions, GetRange, ObjectMeta, ObjectStore, ObjectStoreExt, PutPayload, WriteMultipart,
};
use sha2::{Digest, Sha256};
use std::sync::Arc;
use tokio::fs::File;
use tokio::io::{AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio_util::bytes::{Bytes, BytesMut};

use crate::store::StoreError;
use crate::store::artifacts::object_store_config::ObjectStoreConfig;
use crate::store::hash::hex;

/// Concurrently uploaded parts of a file.
const CONCURRENT_PARTS: usize = 4;
/// Maximum number of parts of a file, slightly below the 10,000 of S3.
const MAX_PARTS: u64 = 9_000;
/// Maximum number of consecutive resumes of a download without new bytes.
const MAX_STALLED_RESUMES: u32 = 3;
/// Maximum number of resumes of a download.
const MAX_RESUMES: u32 = 1_000;
/// Delay between two attempts.
const RETRY_INTERVAL: Duration = Duration::from_millis(200);
/// Timeout of a request that only checks whether the object store answers.
const PING_TIMEOUT: Duration = Duration::from_secs(3);

/// An object.
pub(in crate::store) struct RemoteObject {
    pub(in crate::store) key: String,
    pub(in crate::store) bytes: u64,
    pub(in crate::store) written: SystemTime,
}

impl From<ObjectMeta> for RemoteObject {
    fn from(meta: ObjectMeta) -> Self {
        Self { key: meta.location.to_string(), bytes: meta.size, written: meta.last_modified.into() }
    }
}

/// The object store, under the prefix of this database.
pub(in crate::store) struct Remote {
    objects: PrefixStore<Arc<dyn ObjectStore>>,
    part: usize,
    prefix: Key,
    /// Signs URLs for callers that are redirected.
    signer: Option<Arc<dyn Signer>>,
}

/// The state of a download.
struct PartialDownload {
    hasher: Sha256,
    bytes: u64,
    /// The total size, once known.
    size: Option<u64>,
}

impl Remote {
    pub(in crate::store) fn open(config: &ObjectStoreConfig) -> Result<Self, StoreError> {
        let prefix = config.prefix().clone();
        let objects = PrefixStore::new(config.connect()?.objects, prefix.clone());
        Ok(Self { objects, part: config.part_bytes, prefix, signer: config.signer()? })
    }

    /// Stores bytes; replaces an existing object.
    pub(in crate::store) async fn put(&self, key: &str, bytes: Bytes) -> Result<(), StoreError> {
        let to = Key::from(key);
        let size = bytes.len();
        if size <= self.part {
            self.objects.put(&to, PutPayload::from(bytes)).await.map_err(failed)?;
            return Ok(());
        }
        let mut upload = self.begin(&to, size as u64).await?;
        upload.put(bytes);
        upload.finish().await.map_err(failed)?;
        Ok(())
    }

    /// Stores a file; replaces an existing object.
    pub(in crate::store) async fn put_file(&self, key: &str, path: &Path) -> Result<(), StoreError> {
        let (to, mut file) = (Key::from(key), File::open(path).await?);
        let size = file.metadata().await?.len();
        if size <= self.part as u64 {
            let mut bytes = Vec::new();
            file.read_to_end(&mut bytes).await?;
            self.objects.put(&to, PutPayload::from(bytes)).await.map_err(failed)?;
            return Ok(());
        }
        let mut upload = self.begin(&to, size).await?;
        match send(&mut file, &mut upload).await {
            Ok(()) => upload.finish().await.map(drop).map_err(failed),
            Err(error) => {
                upload.abort().await.ok();
                Err(error)
            }
        }
    }

    async fn begin(&self, to: &Key, size: u64) -> Result<WriteMultipart, StoreError> {
        let part = usize::try_from(size / MAX_PARTS).unwrap_or(usize::MAX).max(self.part);
        let upload = self.objects.put_multipart(to).await.map_err(failed)?;
        Ok(WriteMultipart::new_with_chunk_size(upload, part))
    }

    /// Downloads an object to `to` and returns its hash and size. After a broken connection it resumes the download.
    ///
    /// # Errors
    /// [`StoreError::Missing`] if the object does not exist; [`StoreError::ArtifactsUnreachable`] if no more bytes arrive.
    pub(in crate::store) async fn fetch(
        &self,
        key: &str,
        to: &mut (impl AsyncWrite + Unpin),
    ) -> Result<(String, u64), StoreError> {
        let mut partial = PartialDownload { hasher: Sha256::new(), bytes: 0, size: None };
        let mut fruitless = 0;
        for _ in 0..MAX_RESUMES {
            let before = partial.bytes;
            match self.resume(key, &mut partial, to).await {
                Ok(()) => break,
                Err(error @ StoreError::ArtifactsUnreachable(_)) => {
                    fruitless = if partial.bytes > before { 0 } else { fruitless + 1 };
                    // A request without any answer has already been retried long enough.
                    if fruitless == MAX_STALLED_RESUMES || partial.size.is_none() {
                        return Err(error);
                    }
                    tracing::info!(%error, key, bytes = partial.bytes, "resuming an interrupted download of an artifact");
                }
                Err(error) => return Err(error),
            }
            tokio::time::sleep(RETRY_INTERVAL).await;
        }
        to.flush().await?;
        Ok((hex(&partial.hasher.finalize()), partial.bytes))
    }

    async fn resume(
        &self,
        key: &str,
        partial: &mut PartialDownload,
        to: &mut (impl AsyncWrite + Unpin),
    ) -> Result<(), StoreError> {
        if partial.size == Some(partial.bytes) {
            return Ok(());
        }
        let range = (partial.bytes > 0).then_some(GetRange::Offset(partial.bytes));
        let options = GetOptions { range, ..GetOptions::default() };
        let found = self.objects.get_opts(&Key::from(key), options).await.map_err(|e| of(key, e))?;
        partial.size = Some(found.meta.size);
        let mut body = found.into_stream();
        while let Some(chunk) = body.next().await {
            let chunk = chunk.map_err(failed)?;
            to.write_all(&chunk).await?;
            partial.hasher.update(&chunk);
            partial.bytes += chunk.len() as u64;
        }
        Ok(())
    }

    /// The hash of an object's bytes.
    pub(in crate::store) async fn hash(&self, key: &str) -> Result<String, StoreError> {
        Ok(self.fetch(key, &mut tokio::io::sink()).await?.0)
    }

    /// Streams bytes `range` of an object.
    pub(in crate::store) async fn stream(
        &self,
        key: &str,
        range: std::ops::Range<u64>,
    ) -> Result<BoxStream<'static, Result<Bytes, StoreError>>, StoreError> {
        let options = GetOptions { range: Some(GetRange::Bounded(range)), ..GetOptions::default() };
        let found = self.objects.get_opts(&Key::from(key), options).await.map_err(|e| of(key, e))?;
        Ok(found.into_stream().map_err(failed).boxed())
    }

    /// Reads an object.
    pub(in crate::store) async fn get(&self, key: &str) -> Result<Bytes, StoreError> {
        let found = self.objects.get(&Key::from(key)).await.map_err(|e| of(key, e))?;
        found.bytes().await.map_err(failed)
    }

    /// The size of an object; `None` if it does not exist.
    pub(in crate::store) async fn size(&self, key: &str) -> Result<Option<u64>, StoreError> {
        match self.objects.head(&Key::from(key)).await {
            Ok(found) => Ok(Some(found.size)),
            Err(Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(failed(error)),
        }
    }

    /// A URL that permits reading an object for a limited time; `None` if callers are not redirected.
    pub(in crate::store) async fn signed(
        &self,
        key: &str,
        lasts: Duration,
    ) -> Result<Option<String>, StoreError> {
        let Some(signer) = &self.signer else { return Ok(None) };
        let path: Key = self.prefix.parts().chain(Key::from(key).parts()).collect();
        let url = signer.signed_url(Method::GET, &path, lasts).await.map_err(failed)?;
        Ok(Some(url.into()))
    }

    /// Removes an object. A missing object is not an error.
    pub(in crate::store) async fn remove(&self, key: &str) -> Result<(), StoreError> {
        match self.objects.delete(&Key::from(key)).await {
            Ok(()) | Err(Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(failed(error)),
        }
    }

    /// Moves an object.
    pub(in crate::store) async fn rename(&self, from: &str, to: &str) -> Result<(), StoreError> {
        self.objects.rename(&Key::from(from), &Key::from(to)).await.map_err(|e| of(from, e))
    }

    /// All objects in a folder; `""` for all folders.
    pub(in crate::store) async fn list(&self, folder: &str) -> Result<Vec<RemoteObject>, StoreError> {
        let found = self.objects.list(Some(&Key::from(folder))).map_ok(RemoteObject::from);
        found.map_err(failed).try_collect().await
    }

    /// Checks that the object store answers within a few seconds.
    pub(in crate::store) async fn ping(&self) -> Result<(), StoreError> {
        let look = tokio::time::timeout(PING_TIMEOUT, self.size("captures/none")).await;
        look.map_err(|_| StoreError::ArtifactsUnreachable("it does not answer".to_owned()))?.map(drop)
    }
}

async fn send(file: &mut File, upload: &mut WriteMultipart) -> Result<(), StoreError> {
    let mut buffer = BytesMut::new();
    loop {
        buffer.reserve(1 << 20);
        if file.read_buf(&mut buffer).await? == 0 {
            return Ok(());
        }
        upload.wait_for_capacity(CONCURRENT_PARTS).await.map_err(failed)?;
        upload.put(buffer.split().freeze());
    }
}

/// The error of a request about `key`.
fn of(key: &str, error: Error) -> StoreError {
    match error {
        Error::NotFound { .. } => StoreError::Missing(key.to_owned()),
        error => failed(error),
    }
}

/// Any other error of the object store means that it is unreachable or refuses access, not that stored data are damaged.
fn failed(error: Error) -> StoreError {
    StoreError::ArtifactsUnreachable(error.to_string())
}

/// Downloads an object to a new file and returns its hash and size.
///
/// # Errors
/// As [`Remote::fetch`]; if the file cannot be written.
pub(in crate::store) async fn fetch_to(
    remote: &Remote,
    key: &str,
    path: &Path,
) -> Result<(String, u64), StoreError> {
    let mut file = File::create_new(path).await?;
    let fetched = remote.fetch(key, &mut file).await;
    match fetched {
        Ok(fetched) => file.sync_all().await.map(|()| fetched).map_err(StoreError::from),
        Err(error) => {
            tokio::fs::remove_file(path).await?;
            Err(error)
        }
    }
}
