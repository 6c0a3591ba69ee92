//! Streams request bodies to disk and hashes them.

use std::pin::Pin;

use futures::{Stream, StreamExt};
use object_store::path::Path as Key;
use object_store::{ObjectStoreExt, WriteMultipart};
use sha2::{Digest, Sha256};
use tokio_util::bytes::Bytes;

use crate::store::hash::hex;
use crate::store::pending_quota::Reservation;
use crate::store::staged_upload::{INCOMING, StagedUpload};
use crate::store::{Store, StoreError};
use relume_api::TenantId;

impl Store {
    /// Streams a body of a tenant to disk and hashes it. Its bytes count as stored while they arrive. After an error nothing is
    /// left on disk.
    ///
    /// # Errors
    /// [`StoreError::TooLarge`] beyond `limit` bytes, [`StoreError::Body`] if the sender fails, [`StoreError::Full`] if the disk
    /// is full, [`StoreError::ByteQuotaExceeded`] and [`StoreError::StorageLimitExceeded`] as soon as a limit is exceeded.
    pub async fn receive<E: std::fmt::Display>(
        &self,
        tenant: &TenantId,
        name: &str,
        body: impl Stream<Item = Result<Bytes, E>>,
        limit: u64,
    ) -> Result<StagedUpload, StoreError> {
        let key = Key::from(format!("{INCOMING}/{name}"));
        let body = std::pin::pin!(body);
        let mut upload = WriteMultipart::new(self.artifacts.files().put_multipart(&key).await?);
        let mut reserved = self.reservation(tenant);
        match self.copy(&mut upload, &mut reserved, body, limit).await {
            Ok((sha256, bytes)) => {
                upload.finish().await?;
                reserved.shrink_to(bytes);
                let path = self.artifacts.local_path(key.as_ref());
                Ok(StagedUpload { key, published: false, path, sha256, bytes, upload: None, reserved })
            }
            Err(error) => {
                upload.abort().await.ok();
                Err(error)
            }
        }
    }

    /// Copies `body` into `upload` and updates its hash and size.
    async fn copy<E: std::fmt::Display>(
        &self,
        upload: &mut WriteMultipart,
        reserved: &mut Reservation,
        mut body: Pin<&mut impl Stream<Item = Result<Bytes, E>>>,
        limit: u64,
    ) -> Result<(String, u64), StoreError> {
        let (mut hasher, mut bytes) = (Sha256::new(), 0u64);
        while let Some(chunk) = body.next().await {
            let chunk = chunk.map_err(|e| StoreError::Body(e.to_string()))?;
            bytes += chunk.len() as u64;
            if bytes > limit {
                return Err(StoreError::TooLarge { limit });
            }
            self.reserve(reserved, bytes).await?;
            hasher.update(&chunk);
            upload.wait_for_capacity(2).await?;
            upload.put(chunk);
        }
        Ok((hex(&hasher.finalize()), bytes))
    }
}
