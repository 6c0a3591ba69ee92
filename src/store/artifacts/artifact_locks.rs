//! A lock for each artifact key.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{Mutex as AsyncMutex, OwnedMutexGuard};

/// Maximum number of unused locks in the map.
const MAX_IDLE_LOCKS: usize = 1024;

/// The locks by key.
#[derive(Default)]
pub(super) struct ArtifactLocks(Mutex<HashMap<String, Arc<AsyncMutex<()>>>>);

impl ArtifactLocks {
    /// Waits until no other task holds the lock of `key`.
    pub(super) async fn take(&self, key: &str) -> OwnedMutexGuard<()> {
        let lock = {
            let mut artifact_locks = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            if artifact_locks.len() > MAX_IDLE_LOCKS {
                artifact_locks.retain(|_, lock| Arc::strong_count(lock) > 1);
            }
            artifact_locks.entry(key.to_owned()).or_default().clone()
        };
        lock.lock_owned().await
    }
}
