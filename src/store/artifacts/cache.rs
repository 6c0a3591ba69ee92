//! Tracks the local copies of objects and selects copies for eviction.

use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime};

/// A local copy.
#[derive(Debug, Clone, Copy)]
pub(super) struct CachedFile {
    pub(super) bytes: u64,
    /// Time of the last use.
    pub(super) used: SystemTime,
    /// Whether the object store is known to have the file.
    pub(super) is_in_object_store: bool,
}

/// The copies and the limit of their size.
pub(super) struct Cache {
    most: u64,
    min_age: Duration,
    copies: Mutex<HashMap<String, CachedFile>>,
}

impl Cache {
    pub(super) fn new(most: u64, min_age: Duration, found: HashMap<String, CachedFile>) -> Self {
        Self { most, min_age, copies: Mutex::new(found) }
    }

    /// Adds a written file that is also in the object store.
    pub(super) fn add(&self, key: &str, bytes: u64) {
        self.lock()
            .insert(key.to_owned(), CachedFile { bytes, used: SystemTime::now(), is_in_object_store: true });
    }

    /// Records a use of a file.
    pub(super) fn touch(&self, key: &str) {
        if let Some(copy) = self.lock().get_mut(key) {
            copy.used = SystemTime::now();
        }
    }

    /// Records that the object store has this file.
    pub(super) fn is_in_object_store(&self, key: &str) {
        if let Some(copy) = self.lock().get_mut(key) {
            copy.is_in_object_store = true;
        }
    }

    /// Whether a local file may be missing in the object store.
    pub(super) fn is_local_only(&self, key: &str) -> bool {
        self.lock().get(key).is_some_and(|copy| !copy.is_in_object_store)
    }

    pub(super) fn forget(&self, key: &str) {
        self.lock().remove(key);
    }

    /// A file that may be evicted, because it was not used within the minimum age.
    pub(super) fn idle(&self, key: &str) -> Option<CachedFile> {
        let found = self.lock().get(key).copied();
        found.filter(|copy| self.is_idle(copy))
    }

    /// The files to evict to keep the limit: the least recently used, but none that was used within the minimum age.
    pub(super) fn evictable(&self) -> Vec<String> {
        let copies = self.lock();
        let mut excess = copies.values().map(|copy| copy.bytes).sum::<u64>().saturating_sub(self.most);
        if excess == 0 {
            return Vec::new();
        }
        let mut idle: Vec<_> = copies.iter().filter(|(_, copy)| self.is_idle(copy)).collect();
        idle.sort_by_key(|(_, copy)| copy.used);
        let goes = idle.into_iter().take_while(|(_, copy)| {
            let is_too_much = excess > 0;
            excess = excess.saturating_sub(copy.bytes);
            is_too_much
        });
        goes.map(|(key, _)| key.clone()).collect()
    }

    fn is_idle(&self, copy: &CachedFile) -> bool {
        // A time in the future was written by another clock.
        copy.used.elapsed().map_or(true, |since| since >= self.min_age)
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<String, CachedFile>> {
        self.copies.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cache(most: u64, min_age: Duration) -> Cache {
        let cache = Cache::new(most, min_age, HashMap::new());
        for (key, ago) in [("a", 300), ("b", 200), ("c", 100)] {
            let used = SystemTime::now() - Duration::from_secs(ago);
            cache.lock().insert(key.to_owned(), CachedFile { bytes: 10, used, is_in_object_store: true });
        }
        cache
    }

    #[test]
    fn object_cache_evicts_least_recently_used_above_its_limit() {
        assert!(cache(30, Duration::ZERO).evictable().is_empty());
        assert_eq!(cache(29, Duration::ZERO).evictable(), ["a"]);
        let cache = cache(15, Duration::ZERO);
        cache.touch("a");
        assert_eq!(cache.evictable(), ["b", "c"]);
        cache.forget("b");
        assert_eq!(cache.evictable(), ["c"]);
    }

    #[test]
    fn recently_used_objects_are_never_evicted() {
        let cache = cache(0, Duration::from_secs(150));
        assert_eq!(cache.evictable(), ["a", "b"]);
        assert!(cache.idle("c").is_none() && cache.idle("b").is_some() && cache.idle("d").is_none());
    }
}
