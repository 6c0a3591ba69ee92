//! One piece of work at a time for each key: whoever comes second finds what the first has made.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError, Weak};

use tokio::sync::OwnedMutexGuard;

/// The keys that are being worked on.
#[derive(Clone, Default)]
pub(super) struct Turns(Arc<Mutex<HashMap<String, Weak<tokio::sync::Mutex<()>>>>>);

/// The right to work on a key, until it is dropped.
pub(super) struct Turn {
    _held: OwnedMutexGuard<()>,
}

impl Turns {
    /// Waits until nobody else works on `key`.
    pub(super) async fn take(&self, key: &str) -> Turn {
        Turn { _held: self.of(key).lock_owned().await }
    }

    fn of(&self, key: &str) -> Arc<tokio::sync::Mutex<()>> {
        // Each change of the map is one that cannot panic halfway.
        let mut keys = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        keys.retain(|_, turn| turn.strong_count() > 0);
        match keys.get(key).and_then(Weak::upgrade) {
            Some(turn) => turn,
            None => {
                let turn = Arc::default();
                keys.insert(key.to_owned(), Arc::downgrade(&turn));
                turn
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn equal_keys_wait_for_one_another_and_nothing_stays() {
        let turns = Turns::default();
        let first = turns.take("a").await;
        let _other = turns.take("b").await;
        let mut second = std::pin::pin!(turns.take("a"));
        assert!(futures::poll!(&mut second).is_pending());
        drop(first);
        drop(second.await);
        let _third = turns.take("c").await;
        let keys: Vec<String> = turns.0.lock().unwrap().keys().cloned().collect();
        assert_eq!(keys.len(), 2, "{keys:?}");
    }
}
