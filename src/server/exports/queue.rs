//! Where requests and the exporter meet.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use crate::server::decoders::Decoders;
use relume_api::ExportId;

/// How exports are made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExportPolicy {
    /// The program that makes videos: a name to be looked for on PATH, or a path.
    pub ffmpeg: PathBuf,
    /// Exports of a tenant that may wait or run.
    pub each: u32,
}

impl Default for ExportPolicy {
    fn default() -> Self {
        Self { ffmpeg: "ffmpeg".into(), each: 16 }
    }
}

/// What requests and the exporter share.
pub(in crate::server) struct ExportQueue {
    pub(super) policy: ExportPolicy,
    /// Threads that make files other than frames: neither those of the engine, nor those that read uploads.
    pub(super) file_threads: Decoders,
    frames: Notify,
    files: Notify,
    running: Mutex<HashMap<ExportId, CancellationToken>>,
}

impl ExportQueue {
    /// Nothing runs; `file_threads` are threads of its own.
    pub(in crate::server) fn new(policy: ExportPolicy, file_threads: Decoders) -> Self {
        Self { policy, file_threads, frames: Notify::new(), files: Notify::new(), running: Mutex::default() }
    }

    /// Tells the exporter that there is something to do, or to clear away.
    pub(super) fn wake(&self) {
        self.frames.notify_one();
        self.files.notify_one();
    }

    /// Ends when it was told so, since it was asked last.
    pub(super) async fn wait_for_wake(&self, frames: bool) {
        if frames { self.frames.notified().await } else { self.files.notified().await }
    }

    /// Notes that an export runs until `token` is cancelled.
    pub(super) fn begin(&self, id: &ExportId, token: CancellationToken) {
        self.running().insert(id.clone(), token);
    }

    /// Notes that it runs no longer.
    pub(super) fn end(&self, id: &ExportId) {
        self.running().remove(id);
    }

    /// Stops an export if it runs.
    pub(super) fn stop(&self, id: &ExportId) {
        if let Some(token) = self.running().get(id) {
            token.cancel();
        }
    }

    fn running(&self) -> MutexGuard<'_, HashMap<ExportId, CancellationToken>> {
        self.running.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
