//! A lock for each key: only one task works on a key at a time, and the next one finds its result.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError, Weak};

use tokio::sync::OwnedMutexGuard;

/// The locks of keys in use.
#[derive(Clone, Default)]
pub(super) struct KeyedLocks(Arc<Mutex<HashMap<String, Weak<tokio::sync::Mutex<()>>>>>);

/// The lock of a key, held until this is dropped.
pub(super) struct KeyGuard {
    _held: OwnedMutexGuard<()>,
}

impl KeyedLocks {
    /// Waits for the lock of `key`.
    pub(super) async fn take(&self, key: &str) -> KeyGuard {
        KeyGuard { _held: self.of(key).lock_owned().await }
    }

    fn of(&self, key: &str) -> Arc<tokio::sync::Mutex<()>> {
        // No change of the map can panic halfway, so a poisoned lock is still valid.
        let mut keys = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        keys.retain(|_, lock| lock.strong_count() > 0);
        match keys.get(key).and_then(Weak::upgrade) {
            Some(lock) => lock,
            None => {
                let lock = Arc::default();
                keys.insert(key.to_owned(), Arc::downgrade(&lock));
                lock
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn keyed_lock_serialises_equal_keys_and_frees_unused_ones() {
        let keyed_locks = KeyedLocks::default();
        let first = keyed_locks.take("a").await;
        let _other = keyed_locks.take("b").await;
        let mut second = std::pin::pin!(keyed_locks.take("a"));
        assert!(futures::poll!(&mut second).is_pending());
        drop(first);
        drop(second.await);
        let _third = keyed_locks.take("c").await;
        let keys: Vec<String> = keyed_locks.0.lock().unwrap().keys().cloned().collect();
        assert_eq!(keys.len(), 2, "{keys:?}");
    }
}
