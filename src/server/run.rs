//! A server from start to end: lock the data directory, recover, serve, drain.

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
use crate::server::router::{openapi, router};
use crate::server::signing_secret::SigningSecret;
use crate::server::telemetry;
use crate::server::thumbnail_cache::ThumbnailCache;
use crate::server::webhooks::WebhookPolicy;
use crate::store::{
    DataDirLock, DatabaseUrl, ObjectStoreConfig, Quota, Retention, ServerLock, Store, StoreError,
    UploadLimits, has_keys,
};
use crate::worker::{DeviceHandle, WorkerOptions};
use relume_engine::DeviceError;

/// Time between two searches for leases that ran out; metrics are maintained then, too.
const MAINTENANCE_INTERVAL: Duration = Duration::from_secs(10);
/// Bytes of rendered thumbnails that are kept unless another bound is given.
const THUMBNAIL_CACHE: u64 = 256 << 20;
/// How long open connections may take to end after a shutdown was asked for.
const DRAIN: Duration = Duration::from_secs(20);

/// How a server runs.
#[derive(Clone)]
pub struct ServerConfig {
    /// Where everything is stored. One server for each directory.
    pub data_dir: PathBuf,
    /// Where metadata are instead of in a file of SQLite in that directory. One server for each database, and replicas.
    pub database: Option<DatabaseUrl>,
    /// Whether another server is the first on the database: this one answers, renders and trains, and takes no files in, makes no
    /// exports and deletes nothing. Needs a `database`, and artifacts that both reach.
    pub replica: bool,
    /// The object store that has artifacts, of which the data directory is a cache then.
    pub artifacts: Option<ObjectStoreConfig>,
    /// Accepted keys beside those in the database; without any at all, everyone is accepted, on loopback only.
    pub api_keys: ApiKeys,
    /// Origins whose web pages may call the API.
    pub cors_origins: Vec<CorsOrigin>,
    /// Names beside loopback by which a server without a key may be called.
    pub allowed_hosts: Vec<String>,
    /// Bounds on requests.
    pub limits: RequestLimits,
    /// Bounds on uploads that arrive in pieces.
    pub uploads: UploadLimits,
    /// Bounds on connections.
    pub connections: ConnectionLimits,
    /// Requests that a key may make a minute; any number when absent.
    pub requests_per_minute: Option<u32>,
    /// Requests that all keys of a tenant may make a minute; ten times that of a key when absent.
    pub requests_per_minute_of_tenant: Option<u32>,
    /// Bytes of rendered thumbnails that are kept in the data directory; 0 for none. No tenant's quota counts them.
    pub thumbnail_cache: u64,
    /// How much a tenant may have.
    pub quota: Quota,
    /// How leases behave.
    pub lease: LeasePolicy,
    /// What is done about photographs without poses.
    pub poses: PosesPolicy,
    /// From where captures may be fetched.
    pub fetching: FetchPolicy,
    /// How exports are made.
    pub exports: ExportPolicy,
    /// What webhooks may do.
    pub webhooks: WebhookPolicy,
    /// How long things are kept.
    pub retention: Retention,
    /// Sizes of the worker.
    pub worker: WorkerOptions,
    /// Which devices train. Frames are rendered on that of `worker`.
    pub trainers: Trainers,
    /// Labels of this server's workers, which jobs may ask for.
    pub worker_labels: Vec<String>,
    /// Tells the time.
    pub clock: Arc<dyn Clock>,
    /// Makes identifiers.
    pub ids: Arc<dyn Ids>,
}

impl ServerConfig {
    /// The defaults on a data directory.
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
            worker: WorkerOptions::default(),
            trainers: Trainers::default(),
            worker_labels: Vec::new(),
            clock: Arc::new(SystemClock),
            ids: Arc::new(RandomIds),
        }
    }
}

/// Why a server did not start or did not end well.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// Without a key it would be open to the network.
    #[error(
        "refusing to listen on {0} without an API key; make one with `relume keys create`, set --api-key-file or RELUME_API_KEYS, or bind 127.0.0.1"
    )]
    Exposed(SocketAddr),
    /// Without a key any web page could use it.
    #[error(
        "refusing the CORS origin * without an API key: any web page could use this server; make a key with `relume keys create`"
    )]
    OpenToPages,
    /// The data directory cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The device that was asked for cannot be had.
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

/// Serves until `shutdown` resolves, then drains: claims nothing more, checkpoints and releases the running job,
/// ends event streams and lets open requests finish.
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
    let background_tasks = (!config.replica).then(|| BackgroundTasks::begin(&app, config.retention));
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
    if let Err(error) = jobs.remove_workers(Some(name.as_str())).await {
        tracing::warn!(%error, "the workers of this server stay on the list until the next start");
    }
    store.close().await;
    tracing::info!("stopped");
    Ok(())
}

/// What trains and renders.
fn plan(config: &ServerConfig) -> LocalWorkersConfig {
    LocalWorkersConfig {
        options: config.worker,
        trainers: config.trainers.clone(),
        labels: config.worker_labels.clone(),
        heartbeat_timeout: config.lease.heartbeat_timeout,
    }
}

/// Whether everyone is accepted.
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

/// Opens what is stored.
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

/// Opens what was rendered before.
async fn open_thumbnails(config: &ServerConfig) -> std::io::Result<ThumbnailCache> {
    let (data_dir, most) = (config.data_dir.clone(), config.thumbnail_cache);
    let opened = tokio::task::spawn_blocking(move || ThumbnailCache::open(&data_dir, most)).await;
    opened.map_err(std::io::Error::other)
}

/// All routes behind all that stands before them.
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
        opened: OpenedCaptures::default(),
        poses: PoseQueue::new(config.poses.clone()),
        encoders: Encoders::new(),
        decoders: Decoders::start(config.limits.memory_bytes)?,
        exports: ExportQueue::new(config.exports.clone(), Decoders::start(config.limits.memory_bytes)?),
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
        most_uploaded: config.limits.capture_bytes,
    };
    let app = Arc::new(app);
    Ok((router(app.clone(), stack), app))
}

/// Takes back what a server that died left. The caller holds the node lock, so no other process works here.
async fn recover(store: &Store, jobs: &Jobs, server: &str) -> Result<(), StoreError> {
    store.artifacts().clean_up_incoming()?;
    store.recover_uploads().await?;
    let exports = store.requeue_exports(None).await?;
    if exports > 0 {
        tracing::info!(exports, "goes on with exports of a server that ended");
    }
    let take_back = async || {
        jobs.reset_worker_registry(server).await?;
        jobs.reclaim_all().await
    };
    let recovered = match take_back().await {
        // A crash on a full disk leaves a job that has to be taken back on a full disk.
        Err(StoreError::Full) if store.disk_space().spend_reserve() => take_back().await?,
        recovered => recovered?,
    };
    if !recovered.is_empty() {
        tracing::info!(jobs = recovered.len(), "recovered jobs of a server that died");
    }
    // What was deleted goes before what nothing refers to, which would be set aside.
    if let Err(error) = store.finish_deletions(jobs.now_ms()).await {
        tracing::error!(%error, "what was deleted cannot be swept yet");
    }
    if let Err(error) = store.clean_up_orphans(SystemTime::now()).await {
        tracing::error!(%error, "left-overs cannot be swept");
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

/// Sends to the object store what only this machine has and clears up there, once it can be reached.
async fn reconcile(store: Store) {
    while let Err(error) = store.reconcile_artifacts(SystemTime::now()).await {
        tracing::error!(%error, "the object store of artifacts is not settled yet");
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
                    tracing::error!(%error, "another server took over while the database was away; this one stops");
                    stop.cancel();
                }
                Err(error) => {
                    tracing::error!(%error, "whether this is the first server is not known for now")
                }
            },
        }
        if let Err(error) = jobs.sync_clock().await {
            tracing::error!(%error, "the time of the database is not known for now");
        }
        if let Err(error) = registry.heartbeat(&jobs).await {
            tracing::error!(%error, "expired leases cannot be taken back");
        }
        if let Err(error) = jobs.store().check_disk_space().await {
            tracing::error!(%error, "there is no room to work");
        }
        jobs.store().artifacts().trim().await;
        telemetry::metrics_handle().run_upkeep();
        tokio::time::sleep(MAINTENANCE_INTERVAL.min(registry.interval())).await;
    }
}
