//! Complete uploads under `incoming/`, which get a key when they are published.

use std::path::PathBuf;

use object_store::path::Path as Key;

use crate::store::pending_quota::Reservation;
use crate::store::uploads::UploadLock;

/// The folder of staged uploads.
pub(super) const INCOMING: &str = "incoming";

/// A complete upload that has no key yet. It is deleted when dropped unless it was published.
#[derive(Debug)]
pub struct StagedUpload {
    pub(super) key: Key,
    pub(super) published: bool,
    /// The file on this machine.
    pub path: PathBuf,
    /// Hash of the bytes, lower-case hex.
    pub sha256: String,
    /// Number of bytes.
    pub bytes: u64,
    /// The resumable upload with these bytes, if any.
    pub(super) upload: Option<UploadLock>,
    /// The reservation of these bytes.
    pub(super) reserved: Reservation,
}

impl StagedUpload {
    /// Takes over the resumable upload of `other`, from which these bytes were made. It is removed when these bytes are
    /// published, and kept when they are dropped.
    #[must_use]
    pub fn replacing(mut self, mut other: Self) -> Self {
        self.upload = other.upload.take();
        self
    }

    /// Whether its bytes belong to a resumable upload, which is kept when this is dropped.
    pub fn is_from_upload(&self) -> bool {
        self.upload.is_some()
    }
}

impl Drop for StagedUpload {
    fn drop(&mut self) {
        if !self.published
            && let Err(error) = std::fs::remove_file(&self.path)
        {
            tracing::warn!(%error, key = %self.key, "cannot remove a discarded upload");
        }
    }
}
