//! Looks after what is stored: deletes what was kept for long enough and removes the files of what was deleted.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use crate::jobs::Jobs;
use crate::server::poses;
use crate::server::thumbnail_cache::ThumbnailCache;
use crate::store::Retention;

/// Time between two looks when nobody asks for one.
const INTERVAL: Duration = Duration::from_secs(10);
/// The same while something deleted is still in use.
const WHILE_WAITING: Duration = Duration::from_millis(500);

/// Who looks after it.
pub(super) struct GarbageCollector {
    pub(super) jobs: Jobs,
    pub(super) retention: Retention,
    pub(super) thumbnails: ThumbnailCache,
}

impl GarbageCollector {
    /// Works until `stop` is cancelled; `wake` asks for a look at once.
    pub(super) async fn run(self, wake: Arc<Notify>, stop: CancellationToken) {
        // A server that died may have left thumbnails of what it had swept.
        self.clear_thumbnails().await;
        loop {
            let pause = self.collect().await;
            tokio::select! {
                () = stop.cancelled() => return,
                () = wake.notified() => {}
                () = tokio::time::sleep(pause) => {}
            }
        }
    }

    /// One look; how long to wait for the next.
    async fn collect(&self) -> Duration {
        if let Err(error) = poses::remove_leftovers(self.jobs.store()).await {
            tracing::error!(%error, "what COLMAP left cannot be removed yet");
        }
        match self.jobs.collect_garbage(&self.retention).await {
            Ok(swept) => {
                if swept.things > 0 {
                    self.clear_thumbnails().await;
                }
                if swept.waiting > 0 { WHILE_WAITING } else { INTERVAL }
            }
            Err(error) => {
                tracing::error!(%error, "what was deleted cannot be swept yet");
                INTERVAL
            }
        }
    }

    /// Removes thumbnails of models and captures that there are no longer.
    async fn clear_thumbnails(&self) {
        if self.thumbnails.is_empty() {
            return;
        }
        match self.jobs.store().ids_with_thumbnails().await {
            Ok(shown) => self.thumbnails.keep_only(shown).await,
            Err(error) => tracing::error!(%error, "thumbnails of what was deleted cannot be removed yet"),
        }
    }
}
