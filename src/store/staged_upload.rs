//! Complete uploads under `incoming/`, which get a key when something was made of them.

use std::path::PathBuf;

use object_store::path::Path as Key;

use crate::store::pending_quota::Reservation;
use crate::store::uploads::UploadLock;

/// The folder of uploads on their way.
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
    /// The upload that these bytes are of, if they came in pieces.
    pub(super) upload: Option<UploadLock>,
    /// They count as stored meanwhile.
    pub(super) reserved: Reservation,
}

impl StagedUpload {
    /// These bytes were made of `other`, whose upload is gone once these are published, and stays when they are dropped.
    #[must_use]
    pub fn replacing(mut self, mut other: Self) -> Self {
        self.upload = other.upload.take();
        self
    }

    /// Whether it is an upload that stays when this is dropped.
    pub fn is_from_upload(&self) -> bool {
        self.upload.is_some()
    }
}

impl Drop for StagedUpload {
    fn drop(&mut self) {
        if !self.published
            && let Err(error) = std::fs::remove_file(&self.path)
        {
            tracing::warn!(%error, key = %self.key, "an upload could not be discarded");
        }
    }
}
