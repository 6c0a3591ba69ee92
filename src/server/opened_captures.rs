//! Keeps captures open for a while, so that a page of thumbnails reads the index of an archive only once.

use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use lru::LruCache;

use crate::server::keyed_locks::KeyedLocks;
use crate::server::problem::Problem;
use relume_capture::CapturePhotos;

/// Maximum number of open captures.
const MAX_OPEN_CAPTURES: NonZeroUsize = NonZeroUsize::new(4).unwrap();
/// Time for which a capture stays open.
const KEEP_OPEN: Duration = Duration::from_secs(30);

/// An open capture.
pub(super) struct Opened {
    pub(super) photographs: CapturePhotos,
}

/// The open captures, by the hash of their archives. Clones share them.
#[derive(Clone)]
pub(super) struct OpenedCaptures {
    open: Arc<Mutex<LruCache<String, Arc<Opened>>>>,
    keyed_locks: KeyedLocks,
}

impl Default for OpenedCaptures {
    fn default() -> Self {
        Self {
            open: Arc::new(Mutex::new(LruCache::new(MAX_OPEN_CAPTURES))),
            keyed_locks: KeyedLocks::default(),
        }
    }
}

impl OpenedCaptures {
    /// The capture with this hash. `open` opens it if it is not open.
    ///
    /// # Errors
    /// The error of `open`.
    pub(super) async fn get(
        &self,
        sha256: &str,
        open: impl AsyncFnOnce() -> Result<Opened, Problem>,
    ) -> Result<Arc<Opened>, Problem> {
        // A concurrent request for the same capture finds it open.
        let _key_guard = self.keyed_locks.take(sha256).await;
        if let Some(opened) = self.lock().get(sha256) {
            return Ok(opened.clone());
        }
        let opened = Arc::new(open().await?);
        self.keep(sha256, &opened);
        Ok(opened)
    }

    fn keep(&self, sha256: &str, opened: &Arc<Opened>) {
        self.lock().put(sha256.to_owned(), opened.clone());
        let (kept, sha256, opened) = (self.clone(), sha256.to_owned(), Arc::downgrade(opened));
        tokio::spawn(async move {
            tokio::time::sleep(KEEP_OPEN).await;
            let mut open = kept.lock();
            // The capture may have been opened again since.
            if open.peek(&sha256).is_some_and(|now| std::ptr::eq(Arc::as_ptr(now), opened.as_ptr())) {
                open.pop(&sha256);
            }
        });
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, LruCache<String, Arc<Opened>>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
