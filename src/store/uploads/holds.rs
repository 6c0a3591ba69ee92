//! Who works on an upload: one request at a time.

use std::collections::HashSet;
use std::sync::{Arc, Mutex, PoisonError};

use crate::api::UploadId;

/// The uploads that somebody works on.
#[derive(Debug, Clone, Default)]
pub struct Holds(Arc<Mutex<HashSet<UploadId>>>);

/// Nobody else works on an upload until this is dropped.
#[derive(Debug)]
pub struct Hold {
    holds: Holds,
    id: UploadId,
}

impl Holds {
    /// Takes hold of an upload; `None` while somebody else has it.
    pub(super) fn take(&self, id: &UploadId) -> Option<Hold> {
        let is_free = self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(id.clone());
        is_free.then(|| Hold { holds: self.clone(), id: id.clone() })
    }
}

impl Hold {
    /// What is held.
    pub fn id(&self) -> &UploadId {
        &self.id
    }
}

impl Drop for Hold {
    fn drop(&mut self) {
        self.holds.0.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.id);
    }
}
