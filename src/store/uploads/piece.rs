//! Writing of a chunk of a resumable upload.

use std::fmt::Display;

use futures::{Stream, StreamExt};
use sha1::Sha1;
use sha2::{Digest, Sha256};
use tokio::fs::File;
use tokio::io::{AsyncSeekExt, AsyncWriteExt};
use tokio_util::bytes::Bytes;

use crate::store::pending_quota::Reservation;
use crate::store::uploads::record::UploadRecord;
use crate::store::uploads::upload_locks::UploadLock;
use crate::store::{Store, StoreError, sql};

/// Interval, bytes, after which a long chunk is synced to disk and recorded. At most this much is lost if the process is killed.
const SYNC_INTERVAL_BYTES: u64 = 16 << 20;

/// The expected checksum of a chunk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Checksum {
    /// SHA-1, 20 bytes.
    Sha1(Vec<u8>),
    /// SHA-256, 32 bytes.
    Sha256(Vec<u8>),
}

/// The destination of a chunk.
pub struct Piece<'a> {
    /// The upload as the database has it now.
    pub upload: UploadRecord,
    /// The lock of the upload.
    pub lock: &'a UploadLock,
    /// With a checksum the chunk is stored whole or not at all; without it the received part is stored.
    pub checksum: Option<Checksum>,
    /// Computes the expiry time of the upload from the current time.
    pub expires_ms: &'a (dyn Fn() -> i64 + Send + Sync),
}

/// The expected and the computed checksum.
enum Hashing {
    Nothing,
    Sha1(Sha1, Vec<u8>),
    Sha256(Sha256, Vec<u8>),
}

impl Hashing {
    fn update(&mut self, chunk: &[u8]) {
        match self {
            Self::Nothing => {}
            Self::Sha1(hasher, _) => hasher.update(chunk),
            Self::Sha256(hasher, _) => hasher.update(chunk),
        }
    }

    fn matches(self) -> bool {
        match self {
            Self::Nothing => true,
            Self::Sha1(hasher, expected) => hasher.finalize().as_slice() == expected.as_slice(),
            Self::Sha256(hasher, expected) => hasher.finalize().as_slice() == expected.as_slice(),
        }
    }
}

impl Store {
    /// Appends a chunk after the stored bytes. Returns the updated upload. Even after an error a part of the chunk may be stored.
    ///
    /// # Errors
    /// [`StoreError::TooLarge`] beyond the upload's length, [`StoreError::ChecksumMismatch`], [`StoreError::Body`] if the sender
    /// fails, [`StoreError::Full`], [`StoreError::ByteQuotaExceeded`] and [`StoreError::StorageLimitExceeded`] if a limit is
    /// exceeded.
    pub async fn append<E: Display>(
        &self,
        piece: Piece<'_>,
        body: impl Stream<Item = Result<Bytes, E>>,
    ) -> Result<UploadRecord, StoreError> {
        let path = self.artifacts.local_path(&piece.upload.key());
        let mut file = File::options().write(true).open(path).await?;
        // An interrupted server or request may have left bytes that are not recorded.
        file.set_len(piece.upload.offset()).await?;
        file.seek(std::io::SeekFrom::End(0)).await?;
        let kept = piece.upload.offset();
        let reserved = self.reservation(&piece.upload.tenant);
        let mut writing = Writing { store: self, piece, file, reserved, written: kept, kept };
        let appended = writing.append(body).await;
        if writing.written > writing.kept {
            // Bytes that are not recorded are removed.
            writing.file.set_len(writing.kept).await?;
        }
        appended.map(|()| writing.piece.upload)
    }
}

struct Writing<'a> {
    store: &'a Store,
    piece: Piece<'a>,
    file: File,
    reserved: Reservation,
    /// Bytes in the file.
    written: u64,
    /// Bytes that are on disk and recorded.
    kept: u64,
}

impl Writing<'_> {
    async fn append<E: Display>(
        &mut self,
        body: impl Stream<Item = Result<Bytes, E>>,
    ) -> Result<(), StoreError> {
        let mut hashing = match self.piece.checksum.take() {
            None => Hashing::Nothing,
            Some(Checksum::Sha1(expected)) => Hashing::Sha1(Sha1::new(), expected),
            Some(Checksum::Sha256(expected)) => Hashing::Sha256(Sha256::new(), expected),
        };
        let in_steps = matches!(hashing, Hashing::Nothing);
        let copied = self.copy(body, &mut hashing, in_steps).await;
        match copied {
            Ok(()) if !hashing.matches() => return Err(StoreError::ChecksumMismatch),
            Ok(()) => self.keep().await?,
            Err(_) if in_steps => self.keep().await?,
            Err(_) => {}
        }
        copied
    }

    async fn copy<E: Display>(
        &mut self,
        body: impl Stream<Item = Result<Bytes, E>>,
        hashing: &mut Hashing,
        in_steps: bool,
    ) -> Result<(), StoreError> {
        let mut body = std::pin::pin!(body);
        let limit = self.piece.upload.total();
        while let Some(chunk) = body.next().await {
            let chunk = chunk.map_err(|error| StoreError::Body(error.to_string()))?;
            let written = self.written + chunk.len() as u64;
            if written > limit {
                return Err(StoreError::TooLarge { limit });
            }
            self.store.reserve(&mut self.reserved, written - self.kept).await?;
            hashing.update(&chunk);
            self.file.write_all(&chunk).await?;
            self.written = written;
            if in_steps && self.written - self.kept >= SYNC_INTERVAL_BYTES {
                self.keep().await?;
            }
        }
        Ok(())
    }

    /// Syncs the written bytes to disk and records them.
    async fn keep(&mut self) -> Result<(), StoreError> {
        self.file.flush().await?;
        self.file.sync_data().await?;
        // The bytes are counted as stored and released from the pending quota under one lock.
        let _publish_guard = self.store.publish_lock.lock().await;
        let received = i64::try_from(self.written).unwrap_or(i64::MAX);
        let expires_ms = (self.piece.expires_ms)();
        let mut tx = self.store.write().await?;
        sql::query("UPDATE uploads SET received = $2, expires_ms = $3 WHERE id = $1")
            .bind(self.piece.lock.id())
            .bind(received)
            .bind(expires_ms)
            .execute(&mut tx)
            .await?;
        tx.commit().await?;
        self.reserved.release(self.written - self.kept);
        self.kept = self.written;
        self.piece.upload.received = received;
        self.piece.upload.expires_ms = expires_ms;
        Ok(())
    }
}
