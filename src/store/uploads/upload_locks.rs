//! Who works on an upload: one request at a time.

use std::collections::HashSet;
use std::sync::{Arc, Mutex, PoisonError};

use relume_api::UploadId;

/// The uploads that somebody works on.
#[derive(Debug, Clone, Default)]
pub struct UploadLocks(Arc<Mutex<HashSet<UploadId>>>);

/// Nobody else works on an upload until this is dropped.
#[derive(Debug)]
pub struct UploadLock {
    upload_locks: UploadLocks,
    id: UploadId,
}

impl UploadLocks {
    /// Takes hold of an upload; `None` while somebody else has it.
    pub(super) fn take(&self, id: &UploadId) -> Option<UploadLock> {
        let is_free = self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(id.clone());
        is_free.then(|| UploadLock { upload_locks: self.clone(), id: id.clone() })
    }
}

impl UploadLock {
    /// What is held.
    pub fn id(&self) -> &UploadId {
        &self.id
    }
}

impl Drop for UploadLock {
    fn drop(&mut self) {
        self.upload_locks.0.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.id);
    }
}
