//! One piece of work at a time for each key: whoever comes second finds what the first has made.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError, Weak};

use tokio::sync::OwnedMutexGuard;

/// The keys that are being worked on.
#[derive(Clone, Default)]
pub(super) struct KeyedLocks(Arc<Mutex<HashMap<String, Weak<tokio::sync::Mutex<()>>>>>);

/// The right to work on a key, until it is dropped.
pub(super) struct KeyGuard {
    _held: OwnedMutexGuard<()>,
}

impl KeyedLocks {
    /// Waits until nobody else works on `key`.
    pub(super) async fn take(&self, key: &str) -> KeyGuard {
        KeyGuard { _held: self.of(key).lock_owned().await }
    }

    fn of(&self, key: &str) -> Arc<tokio::sync::Mutex<()>> {
        // Each change of the map is one that cannot panic halfway.
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
