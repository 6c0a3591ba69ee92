//! The life cycle of a server: lock the data directory, recover, serve, drain.

use std::future::Future;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use tokio::net::TcpListener;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use crate::jobs::{Clock, Ids, Jobs, LeasePolicy, RandomIds, SystemClock};
use crate::server::access::AccessControl;
use crate::server::app::{App, AppState, RequestLimits};
use crate::server::auth::{ApiKeys, may_listen};
use crate::server::background_tasks::BackgroundTasks;
use crate::server::connections::{self, ConnectionLimits};
use crate::server::decoders::Decoders;
use crate::server::encoders::Encoders;
use crate::server::exports::{ExportPolicy, ExportQueue};
use crate::server::fetching::{FetchPolicy, Fetcher};
use crate::server::keyed_locks::KeyedLocks;
use crate::server::keyring::Keyring;
use crate::server::local_workers::{
    self, LocalWorkers, LocalWorkersConfig, LocalWorkersError, Trainers, WorkerRegistry,
};
use crate::server::memory::MemoryBudget;
use crate::server::middleware::MiddlewareConfig;
use crate::server::opened_captures::OpenedCaptures;
use crate::server::origins::CorsOrigin;
use crate::server::poses::{PoseQueue, PosesPolicy};
use crate::server::rate_limiter::RateLimiter;
use crate::server::retention_pace::RetentionPace;
use crate::server::router::{openapi, router};
use crate::server::signing_secret::SigningSecret;
use crate::server::telemetry;
use crate::server::thumbnail_cache::ThumbnailCache;
use crate::server::validators::Validators;
use crate::server::webhooks::WebhookPolicy;
use crate::store::{
    DataDirLock, DatabaseUrl, ObjectStoreConfig, Quota, Retention, ServerLock, Store, StoreError,
    UploadLimits, has_keys,
};
use crate::worker::{DecodedMaps, DeviceHandle, WorkerOptions};
use relume_engine::DeviceError;

/// Interval of maintenance: expired leases, metrics, disk space.
const MAINTENANCE_INTERVAL: Duration = Duration::from_secs(10);
/// Default size limit of cached thumbnails, bytes.
const THUMBNAIL_CACHE: u64 = 256 << 20;
/// Maximum time for open connections to end after a shutdown request.
const DRAIN: Duration = Duration::from_secs(20);

/// The configuration of a server.
#[derive(Clone)]
pub struct ServerConfig {
    /// The data directory. Only one server can use it.
    pub data_dir: PathBuf,
    /// The PostgreSQL database for the metadata, in place of a SQLite file in the data directory. One first server and any number
    /// of replicas use it.
    pub database: Option<DatabaseUrl>,
    /// Whether this server is a replica: it answers, renders and trains, but accepts no uploads, makes no exports and deletes
    /// nothing. Requires a `database`, and artifacts that both servers can reach.
    pub replica: bool,
    /// The object store for artifacts, with the data directory as its cache.
    pub artifacts: Option<ObjectStoreConfig>,
    /// Keys that are accepted in addition to those in the database. Without any key all callers are accepted, and the server
    /// listens only on loopback.
    pub api_keys: ApiKeys,
    /// Origins whose web pages may call the API.
    pub cors_origins: Vec<CorsOrigin>,
    /// Host names besides loopback under which clients may call a server without keys.
    pub allowed_hosts: Vec<String>,
    /// Limits of requests.
    pub limits: RequestLimits,
    /// Limits of resumable uploads.
    pub uploads: UploadLimits,
    /// Limits of connections.
    pub connections: ConnectionLimits,
    /// Maximum requests of a key per minute; `None` is unlimited.
    pub requests_per_minute: Option<u32>,
    /// Maximum requests of all keys of a tenant per minute; `None` is ten times the limit of a key.
    pub requests_per_minute_of_tenant: Option<u32>,
    /// Size limit of cached thumbnails in the data directory, bytes; 0 disables the cache. They count towards no tenant's quota.
    pub thumbnail_cache: u64,
    /// The quota of a tenant.
    pub quota: Quota,
    /// Parameters of leases.
    pub lease: LeasePolicy,
    /// The policy for photographs without poses.
    pub poses: PosesPolicy,
    /// The policy for fetching captures.
    pub fetching: FetchPolicy,
    /// The policy for exports.
    pub exports: ExportPolicy,
    /// The policy for webhooks.
    pub webhooks: WebhookPolicy,
    /// The retention of resources.
    pub retention: Retention,
    /// The limits of deletion by age.
    pub retention_pace: RetentionPace,
    /// Options of the worker.
    pub worker: WorkerOptions,
    /// The devices that train. Frames are rendered on the device of `worker`.
    pub trainers: Trainers,
    /// Labels of this server's workers, which jobs can require.
    pub worker_labels: Vec<String>,
    /// The clock.
    pub clock: Arc<dyn Clock>,
    /// The generator of identifiers.
    pub ids: Arc<dyn Ids>,
}

impl ServerConfig {
    /// The default configuration for a data directory.
    pub fn new(data_dir: impl Into<PathBuf>) -> Self {
        Self {
            data_dir: data_dir.into(),
            database: None,
            replica: false,
            artifacts: None,
            api_keys: ApiKeys::default(),
            cors_origins: Vec::new(),
            allowed_hosts: Vec::new(),
            limits: RequestLimits::default(),
            uploads: UploadLimits::default(),
            connections: ConnectionLimits::default(),
            requests_per_minute: None,
            requests_per_minute_of_tenant: None,
            thumbnail_cache: THUMBNAIL_CACHE,
            quota: Quota::default(),
            lease: LeasePolicy::default(),
            poses: PosesPolicy::default(),
            fetching: FetchPolicy::default(),
            exports: ExportPolicy::default(),
            webhooks: WebhookPolicy::default(),
            retention: Retention::default(),
            retention_pace: RetentionPace::default(),
            worker: WorkerOptions::default(),
            trainers: Trainers::default(),
            worker_labels: Vec::new(),
            clock: Arc::new(SystemClock),
            ids: Arc::new(RandomIds),
        }
    }
}

/// Why a server did not start, or failed.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// Without a key it would be open to the network.
    #[error(
        "refusing to listen on {0} without an API key; create one with `relume keys create`, set --api-key-file or RELUME_API_KEYS, or bind 127.0.0.1"
    )]
    Exposed(SocketAddr),
    /// Without a key any web page could use it.
    #[error(
        "refusing the CORS origin * without an API key: any web page could use this server; create a key with `relume keys create`"
    )]
    OpenToPages,
    /// The data directory cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The requested device is not available.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// The network or a thread failed.
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

impl From<LocalWorkersError> for ServeError {
    fn from(error: LocalWorkersError) -> Self {
        match error {
            LocalWorkersError::Device(error) => Self::Device(error),
            LocalWorkersError::Store(error) => Self::Store(error),
            LocalWorkersError::Io(error) => Self::Io(error),
        }
    }
}

/// Serves until `shutdown` resolves, then drains: claims no more jobs, checkpoints and releases the running job, ends event
/// streams and lets open requests finish.
///
/// # Errors
/// See [`ServeError`].
pub async fn run(
    config: ServerConfig,
    listener: TcpListener,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Result<(), ServeError> {
    let address = listener.local_addr()?;
    let is_open = check_openness(&config, address).await?;
    telemetry::metrics_handle();
    let mut lock = DataDirLock::acquire(&config.data_dir)?;
    let name = lock.name(|| config.ids.fresh())?;
    let store = open(&config).await?;
    let first = if config.replica { None } else { Some(store.lock_database().await?) };
    let jobs = Jobs::new(store.clone(), config.clock.clone(), config.ids.clone(), config.lease);
    jobs.sync_clock().await?;
    if first.is_some() {
        recover(&store, &jobs, &name).await?;
    } else {
        jobs.remove_workers(Some(name.as_str())).await?;
    }
    let stop = CancellationToken::new();
    let LocalWorkers { device, threads, registry } =
        local_workers::start(plan(&config), &jobs, &name, &stop).await?;
    let maintenance = tokio::spawn(maintain(jobs.clone(), registry, first, stop.clone()));
    let reconciliation = (!config.replica).then(|| tokio::spawn(reconcile(store.clone())));
    let others = jobs.clone();
    let listening = tokio::spawn(async move { others.listen_for_changes().await });
    let gc_wake = Arc::new(Notify::new());
    let thumbnails = open_thumbnails(&config).await?;
    let (service, app) = service(&config, is_open, jobs.clone(), device, thumbnails, gc_wake, stop.clone())?;
    let background_tasks =
        (!config.replica).then(|| BackgroundTasks::begin(&app, config.retention, config.retention_pace));
    tracing::info!(%address, replica = config.replica, data_dir = %config.data_dir.display(), "serving");
    serve(listener, service, config.connections, shutdown, stop.clone()).await;

    stop.cancel();
    threads.join().await;
    app.poses.idle().await;
    maintenance.abort();
    if let Some(reconciliation) = reconciliation {
        reconciliation.abort();
    }
    listening.abort();
    if let Some(background_tasks) = background_tasks {
        background_tasks.end().await;
    }
    if !config.replica
        && let Err(error) = store.forget_interrupted_validations().await
    {
        tracing::warn!(%error, "the next start counts this stop as an end of the server during its validations");
    }
    if let Err(error) = jobs.remove_workers(Some(name.as_str())).await {
        tracing::warn!(%error, "cannot remove the workers of this server from the registry; the next start removes them");
    }
    store.close().await;
    tracing::info!("stopped");
    Ok(())
}

/// The configuration of the local workers.
fn plan(config: &ServerConfig) -> LocalWorkersConfig {
    LocalWorkersConfig {
        options: config.worker,
        trainers: config.trainers.clone(),
        labels: config.worker_labels.clone(),
        heartbeat_timeout: config.lease.heartbeat_timeout,
    }
}

/// Whether callers without a key are accepted.
///
/// # Errors
/// When the network or web pages could use such a server.
async fn check_openness(config: &ServerConfig, address: SocketAddr) -> Result<bool, ServeError> {
    let is_open = config.api_keys.is_empty() && !has_keys(&config.data_dir, config.database.as_ref()).await?;
    if !may_listen(address, !is_open) {
        return Err(ServeError::Exposed(address));
    }
    if is_open && config.cors_origins.contains(&CorsOrigin::Any) {
        return Err(ServeError::OpenToPages);
    }
    Ok(is_open)
}

/// Opens the store.
async fn open(config: &ServerConfig) -> Result<Store, ServeError> {
    let (root, url) = (&config.data_dir, config.database.as_ref());
    let store = if config.replica {
        Store::open_existing(root, url).await?
    } else {
        Store::open_with(root, url).await?
    };
    let mut store = store.with_quota(config.quota);
    if let Some(place) = &config.artifacts {
        store = store.with_artifacts(place)?;
    }
    if let Some(bytes) = config.limits.disk_bytes {
        store.limit_disk(bytes);
    }
    Ok(store)
}

/// Opens the thumbnail cache.
async fn open_thumbnails(config: &ServerConfig) -> std::io::Result<ThumbnailCache> {
    let (data_dir, most) = (config.data_dir.clone(), config.thumbnail_cache);
    let opened = tokio::task::spawn_blocking(move || ThumbnailCache::open(&data_dir, most)).await;
    opened.map_err(std::io::Error::other)
}

/// All routes with the middleware.
fn service(
    config: &ServerConfig,
    is_open: bool,
    jobs: Jobs,
    device: DeviceHandle,
    thumbnails: ThumbnailCache,
    gc_wake: Arc<Notify>,
    stop: CancellationToken,
) -> Result<(axum::Router, AppState), ServeError> {
    let store = jobs.store().clone();
    let signing = SigningSecret::of(&config.data_dir);
    let keys = Arc::new(Keyring::new(config.api_keys.clone(), store.clone(), config.clock.clone()));
    let rate_limiter = RateLimiter::new(config.requests_per_minute, config.requests_per_minute_of_tenant);
    let app = App {
        store,
        jobs,
        device,
        trains: config.trainers != Trainers::None,
        thumbnails,
        limits: config.limits,
        upload_limits: config.uploads,
        import_limits: config.worker.import_limits,
        memory: MemoryBudget::new(config.limits.memory_bytes),
        thumbnail_locks: KeyedLocks::default(),
        model_locks: KeyedLocks::default(),
        opened: OpenedCaptures::default(),
        maps: DecodedMaps::default(),
        poses: PoseQueue::new(config.poses.clone()),
        encoders: Encoders::new(),
        decoders: Decoders::start(config.limits.memory_bytes)?,
        validators: Validators::start(config.limits.memory_bytes)?,
        exports: ExportQueue::new(
            config.exports.clone(),
            Decoders::start_at_low_priority(config.limits.memory_bytes)?,
        ),
        keys: keys.clone(),
        signing: signing.clone(),
        fetcher: Fetcher::new(config.fetching.clone()),
        webhooks: config.webhooks,
        gc_wake,
        stop,
        description: openapi(),
    };
    let stack = MiddlewareConfig {
        access_control: Arc::new(AccessControl { keys, signing, rate_limiter }),
        is_replica: config.replica,
        is_open,
        origins: config.cors_origins.clone(),
        hosts: config.allowed_hosts.clone().into(),
        body_stall: config.connections.body,
        body_rate: config.connections.body_rate,
        most_uploaded: config.limits.capture_bytes,
    };
    let app = Arc::new(app);
    Ok((router(app.clone(), stack), app))
}

/// Recovers the state that a terminated server left. The caller holds the lock of the data directory, so no other process uses
/// it.
async fn recover(store: &Store, jobs: &Jobs, server: &str) -> Result<(), StoreError> {
    store.artifacts().clean_up_incoming()?;
    store.recover_uploads().await?;
    let exports = store.requeue_exports(None).await?;
    if exports > 0 {
        tracing::info!(exports, "returned the exports of the previous server to the queue");
    }
    let take_back = async || {
        jobs.reset_worker_registry(server).await?;
        jobs.reclaim_all().await
    };
    let recovered = match take_back().await {
        // After a crash on a full disk the jobs must be reclaimed on a full disk.
        Err(StoreError::Full) if store.disk_space().spend_reserve() => take_back().await?,
        recovered => recovered?,
    };
    if !recovered.is_empty() {
        tracing::info!(jobs = recovered.len(), "reclaimed the jobs of the previous server");
    }
    // Deleted resources are removed first, because otherwise their files would be moved to the orphans folder.
    if let Err(error) = store.finish_deletions(jobs.now_ms()).await {
        tracing::error!(%error, "cannot remove the files of deleted resources yet");
    }
    if let Err(error) = store.clean_up_orphans(SystemTime::now()).await {
        tracing::error!(%error, "the startup cleanup of orphans failed");
    }
    Ok(())
}

async fn serve(
    listener: TcpListener,
    service: axum::Router,
    limits: ConnectionLimits,
    shutdown: impl Future<Output = ()> + Send + 'static,
    stop: CancellationToken,
) {
    let stopping = stop.clone();
    let waiting = tokio::spawn(async move {
        shutdown.await;
        tracing::info!("shutting down");
        stopping.cancel();
    });
    if !connections::serve(listener, service, limits, stop, DRAIN).await {
        tracing::warn!("some connections did not end in time");
    }
    waiting.abort();
}

/// Reconciles the local artifacts with the object store, when it is reachable.
async fn reconcile(store: Store) {
    while let Err(error) = store.reconcile_artifacts(SystemTime::now()).await {
        tracing::error!(%error, "the object-store reconciliation failed; retrying");
        tokio::time::sleep(MAINTENANCE_INTERVAL).await;
    }
}

async fn maintain(
    jobs: Jobs,
    mut registry: WorkerRegistry,
    mut first: Option<ServerLock>,
    stop: CancellationToken,
) {
    while !stop.is_cancelled() {
        match first.as_mut().map(ServerLock::renew) {
            None => {}
            Some(kept) => match kept.await {
                Ok(()) => {}
                Err(error @ StoreError::DatabaseLocked) => {
                    tracing::error!(%error, "another server is now the first server; this server stops");
                    stop.cancel();
                }
                Err(error) => {
                    tracing::error!(%error, "cannot check the lock of the first server at present")
                }
            },
        }
        if let Err(error) = jobs.sync_clock().await {
            tracing::error!(%error, "cannot read the time of the database at present");
        }
        if let Err(error) = registry.heartbeat(&jobs).await {
            tracing::error!(%error, "cannot record heartbeats and reclaim expired leases");
        }
        if let Err(error) = jobs.store().check_disk_space().await {
            tracing::error!(%error, "the disk space is not sufficient");
        }
        jobs.store().artifacts().trim().await;
        telemetry::metrics_handle().run_upkeep();
        tokio::time::sleep(MAINTENANCE_INTERVAL.min(registry.interval())).await;
    }
}
