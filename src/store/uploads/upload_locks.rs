//! Locks of uploads: only one request can use an upload at a time.

use std::collections::HashSet;
use std::sync::{Arc, Mutex, PoisonError};

use relume_api::UploadId;

/// The locked uploads.
#[derive(Debug, Clone, Default)]
pub struct UploadLocks(Arc<Mutex<HashSet<UploadId>>>);

/// The lock of an upload, held until it is dropped.
#[derive(Debug)]
pub struct UploadLock {
    upload_locks: UploadLocks,
    id: UploadId,
}

impl UploadLocks {
    /// Locks an upload; `None` if it is already locked.
    pub(super) fn take(&self, id: &UploadId) -> Option<UploadLock> {
        let is_free = self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(id.clone());
        is_free.then(|| UploadLock { upload_locks: self.clone(), id: id.clone() })
    }
}

impl UploadLock {
    /// The locked upload.
    pub fn id(&self) -> &UploadId {
        &self.id
    }
}

impl Drop for UploadLock {
    fn drop(&mut self) {
        self.upload_locks.0.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.id);
    }
}
