//! The garbage collector: deletes resources beyond their retention, and removes the files of deleted resources.

use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use crate::jobs::Jobs;
use crate::server::poses;
use crate::server::retention_pace::RetentionPacer;
use crate::server::thumbnail_cache::ThumbnailCache;
use crate::store::{Retention, StoreError};

/// Time between two runs without a notification.
const INTERVAL: Duration = Duration::from_secs(10);
/// Time between two runs while a deleted resource is still in use.
const WHILE_WAITING: Duration = Duration::from_millis(500);

/// The state of the garbage collector.
pub(super) struct GarbageCollector {
    pub(super) jobs: Jobs,
    pub(super) retention: Retention,
    pub(super) pacer: RetentionPacer,
    pub(super) thumbnails: ThumbnailCache,
}

impl GarbageCollector {
    /// Runs until `stop` is cancelled; `wake` starts a run immediately.
    pub(super) async fn run(mut self, wake: Arc<Notify>, stop: CancellationToken) {
        // A terminated server may have left thumbnails of deleted resources.
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

    /// Performs one run. Returns the time until the next.
    async fn collect(&mut self) -> Duration {
        if let Err(error) = self.expire().await {
            tracing::error!(%error, "cannot delete resources at the end of their retention yet");
        }
        if let Err(error) = poses::remove_leftovers(self.jobs.store()).await {
            tracing::error!(%error, "cannot remove leftover files of COLMAP yet");
        }
        match self.jobs.collect_garbage().await {
            Ok(swept) => {
                if swept.things > 0 {
                    self.clear_thumbnails().await;
                }
                if swept.waiting > 0 { WHILE_WAITING } else { INTERVAL }
            }
            Err(error) => {
                tracing::error!(%error, "cannot remove the files of deleted resources yet");
                INTERVAL
            }
        }
    }

    /// Deletes resources beyond their retention, at the permitted pace.
    async fn expire(&mut self) -> Result<(), StoreError> {
        let (now, clock_ms) = (Instant::now(), self.jobs.now_ms());
        if !self.pacer.is_quiet(now, clock_ms) || self.retention.keeps_everything() {
            return Ok(());
        }
        let store = self.jobs.store();
        let most = self.pacer.allowed(now, store.count_for_retention().await?);
        let deleted = store.expire(&self.retention, most, clock_ms).await?;
        self.pacer.record(now, deleted);
        Ok(())
    }

    /// Removes thumbnails of deleted models and captures.
    async fn clear_thumbnails(&self) {
        if self.thumbnails.is_empty() {
            return;
        }
        match self.jobs.store().ids_with_thumbnails().await {
            Ok(shown) => self.thumbnails.keep_only(shown).await,
            Err(error) => tracing::error!(%error, "cannot remove thumbnails of deleted resources yet"),
        }
    }
}
