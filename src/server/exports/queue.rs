//! The queue between requests and the exporter.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use crate::server::decoders::Decoders;
use relume_api::ExportId;

/// The policy for exports.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExportPolicy {
    /// The program that makes videos: a name on PATH, or a path.
    pub ffmpeg: PathBuf,
    /// Maximum number of queued and running exports of a tenant.
    pub each: u32,
}

impl Default for ExportPolicy {
    fn default() -> Self {
        Self { ffmpeg: "ffmpeg".into(), each: 16 }
    }
}

/// The state that requests and the exporter share.
pub(in crate::server) struct ExportQueue {
    pub(super) policy: ExportPolicy,
    /// Threads that make files other than frames, separate from those of the engine and of uploads.
    pub(super) file_threads: Decoders,
    frames: Notify,
    files: Notify,
    running: Mutex<HashMap<ExportId, CancellationToken>>,
}

impl ExportQueue {
    /// An empty queue with `file_threads`.
    pub(in crate::server) fn new(policy: ExportPolicy, file_threads: Decoders) -> Self {
        Self { policy, file_threads, frames: Notify::new(), files: Notify::new(), running: Mutex::default() }
    }

    /// Wakes the exporter for new exports or for cleanup.
    pub(super) fn wake(&self) {
        self.frames.notify_one();
        self.files.notify_one();
    }

    /// Waits until the exporter is woken.
    pub(super) async fn wait_for_wake(&self, frames: bool) {
        if frames { self.frames.notified().await } else { self.files.notified().await }
    }

    /// Records that an export runs until `token` is cancelled.
    pub(super) fn begin(&self, id: &ExportId, token: CancellationToken) {
        self.running().insert(id.clone(), token);
    }

    /// Records that an export no longer runs.
    pub(super) fn end(&self, id: &ExportId) {
        self.running().remove(id);
    }

    /// Stops an export if it runs.
    pub(super) fn stop(&self, id: &ExportId) {
        if let Some(token) = self.running().get(id) {
            token.cancel();
        }
    }

    /// Stops exports that were returned to the queue, so that they begin again.
    pub(in crate::server) fn begin_again(&self, exports: &[ExportId]) {
        for id in exports {
            self.stop(id);
        }
        self.wake();
    }

    fn running(&self) -> MutexGuard<'_, HashMap<ExportId, CancellationToken>> {
        self.running.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
