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
use crate::server::validators::Validators;
use crate::server::webhooks::WebhookPolicy;
use crate::store::{Store, UploadLimits};
use crate::worker::{DecodedMaps, DeviceHandle};
use relume_capture::ImportLimits;

/// The state that handlers share.
pub(super) type AppState = Arc<App>;

/// Limits of requests.
#[derive(Debug, Clone, Copy)]
pub struct RequestLimits {
    /// Maximum bytes of a capture archive.
    pub capture_bytes: u64,
    /// Maximum bytes of an environment file.
    pub environment_bytes: u64,
    /// Maximum bytes of all stored data; `None` if only the disk limits the storage.
    pub disk_bytes: Option<u64>,
    /// Memory budget of all requests together, bytes.
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

/// Size of a file in an archive that is accepted with any memory budget, bytes.
const MIN_ENTRY_BYTES: u64 = 64 << 20;

/// The state behind the routes.
pub(super) struct App {
    pub(super) store: Store,
    pub(super) jobs: Jobs,
    pub(super) device: DeviceHandle,
    /// Whether this server has local workers.
    pub(super) trains: bool,
    pub(super) limits: RequestLimits,
    pub(super) upload_limits: UploadLimits,
    /// Limits of captures.
    pub(super) import_limits: ImportLimits,
    /// The memory budget of requests.
    pub(super) memory: MemoryBudget,
    /// Cached thumbnails of models and photographs.
    pub(super) thumbnails: ThumbnailCache,
    /// Locks of thumbnails that are being made, by digest.
    pub(super) thumbnail_locks: KeyedLocks,
    /// Locks of models whose files are being replaced.
    pub(super) model_locks: KeyedLocks,
    /// Opened captures, for their photographs.
    pub(super) opened: OpenedCaptures,
    /// Decoded environment maps.
    pub(super) maps: DecodedMaps,
    /// The pose estimation of photographs without poses.
    pub(super) poses: PoseQueue,
    /// Threads that encode frames.
    pub(super) encoders: Encoders,
    /// Threads that decode single photographs and maps, and read the lists of archives.
    pub(super) decoders: Decoders,
    /// Threads that validate whole captures, which may take minutes.
    pub(super) validators: Validators,
    /// The queue between requests and the exporter.
    pub(super) exports: ExportQueue,
    /// All API keys.
    pub(super) keys: Arc<Keyring>,
    /// The secret for signing URLs.
    pub(super) signing: SigningSecret,
    /// Fetches captures from other servers.
    pub(super) fetcher: Fetcher,
    /// The policy for webhooks.
    pub(super) webhooks: WebhookPolicy,
    /// Wakes the garbage collector.
    pub(super) gc_wake: Arc<Notify>,
    /// Cancelled when the server begins to shut down.
    pub(super) stop: CancellationToken,
    /// The description of the API.
    pub(super) description: OpenApi,
}

impl App {
    /// Limits of new captures: no file of an archive, which is unpacked as a whole, takes more than half of the memory budget.
    pub(super) fn limits_of_uploads(&self) -> ImportLimits {
        let most = (self.limits.memory_bytes / 2).max(MIN_ENTRY_BYTES);
        ImportLimits { max_entry_bytes: self.import_limits.max_entry_bytes.min(most), ..self.import_limits }
    }
}
