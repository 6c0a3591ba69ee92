//! A cache of decoded photographs, bounded in bytes, with threads that decode ahead.
//!
//! Decoding is deterministic, so neither the bound nor the threads affect results.

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::dataset::stored_photo::StoredPhoto;
use relume_engine::{Photo, PhotoSize};

/// Threads that decode ahead.
const THREADS: usize = 2;

/// Identifies a decoded photograph: index and size.
pub type Key = (usize, PhotoSize);

/// Statistics of the decoding for the steps of a training.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DecodingStats {
    /// Photographs requested.
    pub asked: u64,
    /// Photographs decoded.
    pub decoded: u64,
    /// Requests for a photograph that was not ready.
    pub waits: u64,
    /// Time spent in such requests.
    pub waited: Duration,
}

/// The cache. It evicts the least recently used photograph first.
#[derive(Debug)]
pub struct PhotoCache {
    shared: Arc<SharedCache>,
    threads: Vec<JoinHandle<()>>,
}

#[derive(Debug)]
struct SharedCache {
    state: Mutex<CacheState>,
    /// Signalled when a photograph was decoded or is to be decoded, and at the end.
    changed: Condvar,
}

#[derive(Debug)]
struct CacheState {
    most: usize,
    entries: HashMap<Key, CacheEntry>,
    /// Bytes of all entries, including those that are being decoded.
    bytes: usize,
    /// Photographs to decode ahead, in order.
    wanted: VecDeque<(Key, Arc<StoredPhoto>)>,
    /// Counts uses, to find the least recently used entry.
    clock: u64,
    /// Number of calls of [`PhotoCache::clear`]. Photographs whose decoding started before the last one are not kept.
    generation: u64,
    stats: DecodingStats,
    ends: bool,
}

#[derive(Debug)]
struct CacheEntry {
    bytes: usize,
    used: u64,
    /// Absent while the photograph is being decoded.
    photo: Option<Arc<Photo>>,
}

impl PhotoCache {
    /// A cache of at most `most` bytes, not counting photographs that only callers hold.
    pub fn new(most: usize) -> Self {
        let state = CacheState {
            most,
            entries: HashMap::new(),
            bytes: 0,
            wanted: VecDeque::new(),
            clock: 0,
            generation: 0,
            stats: DecodingStats::default(),
            ends: false,
        };
        let shared = Arc::new(SharedCache { state: Mutex::new(state), changed: Condvar::new() });
        let start = |k: usize| {
            let shared = shared.clone();
            std::thread::Builder::new()
                .name(format!("relume-photos-{k}"))
                .spawn(move || shared.decode_ahead())
        };
        // Without threads photographs are decoded on request.
        let threads = (0..THREADS).filter_map(|k| start(k).ok()).collect();
        Self { shared, threads }
    }

    /// The photograph: from the cache, from a thread that is decoding it, or decoded by this call.
    pub fn get(&self, key: Key, stored: &StoredPhoto) -> Arc<Photo> {
        let mut state = self.shared.lock();
        state.stats.asked += 1;
        if let Some(photo) = state.ready(key) {
            return photo;
        }
        let start = Instant::now();
        state.wanted.retain(|(wanted, _)| *wanted != key);
        let photo = self.shared.decoded(state, key, stored);
        let mut state = self.shared.lock();
        state.stats.waits += 1;
        state.stats.waited += start.elapsed();
        photo
    }

    /// The photograph if it is ready; not counted in the statistics.
    pub fn peek(&self, key: Key) -> Option<Arc<Photo>> {
        self.shared.lock().entries.get(&key)?.photo.clone()
    }

    /// Starts to decode the photographs that will be requested next, in this order, as far as the bound allows.
    pub fn prefetch(&self, next: impl Iterator<Item = (Key, Arc<StoredPhoto>)>) {
        let mut state = self.shared.lock();
        state.wanted.clear();
        let mut left = state.most;
        for (key, stored) in next {
            let bytes = stored.decoded_bytes(key.1);
            if bytes > left {
                break;
            }
            left -= bytes;
            if state.entries.contains_key(&key) {
                state.touch(key);
            } else {
                state.wanted.push_back((key, stored));
            }
        }
        drop(state);
        self.shared.changed.notify_all();
    }

    /// Clears the cache, because photographs have changed.
    pub fn clear(&self) {
        let mut state = self.shared.lock();
        state.generation += 1;
        state.wanted.clear();
        state.entries.clear();
        state.bytes = 0;
        drop(state);
        self.shared.changed.notify_all();
    }

    /// Bytes of cached photographs, and of those that are being decoded.
    #[cfg(test)]
    pub fn held(&self) -> usize {
        self.shared.lock().bytes
    }

    /// Statistics so far.
    pub fn stats(&self) -> DecodingStats {
        self.shared.lock().stats
    }
}

impl Drop for PhotoCache {
    fn drop(&mut self) {
        self.shared.lock().ends = true;
        self.shared.changed.notify_all();
        for thread in self.threads.drain(..) {
            // A thread that panicked needs no further handling.
            let _ = thread.join();
        }
    }
}

impl SharedCache {
    fn lock(&self) -> MutexGuard<'_, CacheState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait<'a>(&'a self, state: MutexGuard<'a, CacheState>) -> MutexGuard<'a, CacheState> {
        self.changed.wait(state).unwrap_or_else(PoisonError::into_inner)
    }

    /// The loop of a thread: decodes requested photographs until the end.
    fn decode_ahead(&self) {
        let mut state = self.lock();
        while !state.ends {
            let Some((key, stored)) = state.wanted.pop_front() else {
                state = self.wait(state);
                continue;
            };
            if state.entries.contains_key(&key) || !state.make_room(stored.decoded_bytes(key.1)) {
                continue;
            }
            self.decode_into(state, key, &stored);
            state = self.lock();
        }
    }

    /// A photograph that is not ready: waits for the thread that is decoding it, or decodes it.
    fn decoded<'a>(
        &'a self,
        mut state: MutexGuard<'a, CacheState>,
        key: Key,
        stored: &StoredPhoto,
    ) -> Arc<Photo> {
        while state.entries.contains_key(&key) {
            if let Some(photo) = state.ready(key) {
                return photo;
            }
            state = self.wait(state);
        }
        if state.make_room(stored.decoded_bytes(key.1)) {
            return self.decode_into(state, key, stored);
        }
        state.stats.decoded += 1;
        drop(state);
        Arc::new(stored.decoded(key.1))
    }

    /// Decodes into a new entry. The caller has freed memory for it.
    fn decode_into(
        &self,
        mut state: MutexGuard<'_, CacheState>,
        key: Key,
        stored: &StoredPhoto,
    ) -> Arc<Photo> {
        let bytes = stored.decoded_bytes(key.1);
        state.bytes += bytes;
        state.clock += 1;
        let used = state.clock;
        state.entries.insert(key, CacheEntry { bytes, used, photo: None });
        state.stats.decoded += 1;
        let pending = PendingDecode { shared: self, key, generation: state.generation };
        drop(state);
        let photo = Arc::new(stored.decoded(key.1));
        pending.finish(photo.clone());
        photo
    }
}

impl CacheState {
    /// The photograph if it is decoded; marks it as most recently used.
    fn ready(&mut self, key: Key) -> Option<Arc<Photo>> {
        self.touch(key);
        self.entries.get(&key)?.photo.clone()
    }

    fn touch(&mut self, key: Key) {
        self.clock += 1;
        if let Some(entry) = self.entries.get_mut(&key) {
            entry.used = self.clock;
        }
    }

    /// Evicts the least recently used photographs until `bytes` fit; false if they cannot fit.
    fn make_room(&mut self, bytes: usize) -> bool {
        if bytes > self.most {
            return false;
        }
        while self.bytes + bytes > self.most {
            let decoded = self.entries.iter().filter(|(_, entry)| entry.photo.is_some());
            let Some(oldest) = decoded.min_by_key(|(_, entry)| entry.used).map(|(key, _)| *key) else {
                return false;
            };
            self.remove(oldest);
        }
        true
    }

    fn remove(&mut self, key: Key) {
        if let Some(entry) = self.entries.remove(&key) {
            self.bytes -= entry.bytes;
        }
    }
}

/// An entry that is being decoded. Its drop removes the entry if decoding panicked, so that no thread waits for ever.
struct PendingDecode<'a> {
    shared: &'a SharedCache,
    key: Key,
    generation: u64,
}

impl PendingDecode<'_> {
    fn finish(self, photo: Arc<Photo>) {
        let mut state = self.shared.lock();
        if state.generation == self.generation
            && let Some(entry) = state.entries.get_mut(&self.key)
        {
            entry.photo = Some(photo);
        }
    }
}

impl Drop for PendingDecode<'_> {
    fn drop(&mut self) {
        let mut state = self.shared.lock();
        let is_undecoded = state.entries.get(&self.key).is_some_and(|entry| entry.photo.is_none());
        if state.generation == self.generation && is_undecoded {
            state.remove(self.key);
        }
        drop(state);
        self.shared.changed.notify_all();
    }
}
