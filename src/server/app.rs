//! The state behind the routes.

use std::sync::Arc;

use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;
use utoipa::openapi::OpenApi;

use crate::jobs::Jobs;
use crate::server::decoders::Decoders;
use crate::server::encoders::Encoders;
use crate::server::exports::ExportQueue;
use crate::server::fetching::Fetcher;
use crate::server::keyed_locks::KeyedLocks;
use crate::server::keyring::Keyring;
use crate::server::memory::{MemoryBudget, default_budget};
use crate::server::opened_captures::OpenedCaptures;
use crate::server::poses::PoseQueue;
use crate::server::signing_secret::SigningSecret;
use crate::server::thumbnail_cache::ThumbnailCache;
use crate::server::webhooks::WebhookPolicy;
use crate::store::{Store, UploadLimits};
use crate::worker::DeviceHandle;
use relume_capture::ImportLimits;

/// What handlers share.
pub(super) type AppState = Arc<App>;

/// Bounds on what a request may bring.
#[derive(Debug, Clone, Copy)]
pub struct RequestLimits {
    /// Bytes of a capture archive.
    pub capture_bytes: u64,
    /// Bytes of an environment file.
    pub environment_bytes: u64,
    /// Bytes that are stored together; the disk alone is the limit when absent.
    pub disk_bytes: Option<u64>,
    /// Bytes of memory that requests take together.
    pub memory_bytes: u64,
}

impl Default for RequestLimits {
    fn default() -> Self {
        Self {
            capture_bytes: 16 << 30,
            environment_bytes: 256 << 20,
            disk_bytes: None,
            memory_bytes: default_budget(),
        }
    }
}

/// The state behind the routes.
pub(super) struct App {
    pub(super) store: Store,
    pub(super) jobs: Jobs,
    pub(super) device: DeviceHandle,
    /// Whether this server trains itself.
    pub(super) trains: bool,
    pub(super) limits: RequestLimits,
    pub(super) upload_limits: UploadLimits,
    /// Bounds on captures.
    pub(super) import_limits: ImportLimits,
    /// What requests may borrow.
    pub(super) memory: MemoryBudget,
    /// Thumbnails of models that were rendered, and of photographs.
    pub(super) thumbnails: ThumbnailCache,
    /// Thumbnails that are being made, by digest.
    pub(super) thumbnail_locks: KeyedLocks,
    /// Captures whose photographs are being looked at.
    pub(super) opened: OpenedCaptures,
    /// Poses for photographs that come without.
    pub(super) poses: PoseQueue,
    /// Where frames are encoded.
    pub(super) encoders: Encoders,
    /// Where uploads are decoded.
    pub(super) decoders: Decoders,
    /// Where requests and the exporter meet.
    pub(super) exports: ExportQueue,
    /// Who may make requests.
    pub(super) keys: Arc<Keyring>,
    /// Under which URLs are signed.
    pub(super) signing: SigningSecret,
    /// Fetches captures.
    pub(super) fetcher: Fetcher,
    /// What webhooks may do.
    pub(super) webhooks: WebhookPolicy,
    /// Wakes whoever removes the files of what was deleted.
    pub(super) gc_wake: Arc<Notify>,
    /// Cancelled when the server begins to shut down.
    pub(super) stop: CancellationToken,
    /// The description of the API.
    pub(super) description: OpenApi,
}
