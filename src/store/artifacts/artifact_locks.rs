//! One at a time for each key.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{Mutex as AsyncMutex, OwnedMutexGuard};

/// Keys that are kept though nobody works on them.
const MAX_IDLE_LOCKS: usize = 1024;

/// Who works on which key.
#[derive(Default)]
pub(super) struct ArtifactLocks(Mutex<HashMap<String, Arc<AsyncMutex<()>>>>);

impl ArtifactLocks {
    /// Waits until nobody else works on `key`.
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
