//! `relume serve`.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

use crate::cli::CommandResult;
use crate::cli::artifacts::ArtifactsArgs;
use crate::cli::database::DatabaseArgs;
use crate::cli::stop::{StopRequest, on_stop};
use crate::server::{self, CorsOrigin, ServerConfig};
use relume_engine::DeviceChoice;

mod fetching;
mod keys;
mod local_workers;
mod network;
mod poses;
mod storage;
mod tenant_limits;
mod webhooks;

/// Options of `relume serve`.
#[derive(Debug, clap::Args)]
pub(super) struct ServeArgs {
    /// Address to listen on. An address other than loopback requires an API key.
    #[arg(long, env = "RELUME_LISTEN", default_value = "127.0.0.1:7878")]
    listen: SocketAddr,
    /// The data directory, in which the server stores its data.
    #[arg(long, env = "RELUME_DATA_DIR", default_value = "relume-data")]
    data_dir: PathBuf,
    #[command(flatten)]
    database: DatabaseArgs,
    #[command(flatten)]
    artifacts: ArtifactsArgs,
    #[command(flatten)]
    keys: keys::KeyArgs,
    /// Origins whose web pages may call the API, separated by commas, e.g. `https://app.example.org`, or `*` for all (requires an
    /// API key).
    #[arg(long = "cors-origin", env = "RELUME_CORS_ORIGINS", value_delimiter = ',')]
    cors_origins: Vec<CorsOrigin>,
    /// Host names besides localhost under which clients may call a server without an API key, separated by commas, e.g. the name
    /// of a proxy on this machine.
    #[arg(long = "allow-host", env = "RELUME_ALLOWED_HOSTS", value_delimiter = ',')]
    allowed_hosts: Vec<String>,
    /// Maximum size of a capture archive: bytes, or a number with MiB, GiB or TiB.
    #[arg(long, env = "RELUME_MAX_CAPTURE_BYTES", value_name = "SIZE", value_parser = storage::size, default_value = "16GiB")]
    max_capture_bytes: u64,
    /// Maximum size of a photograph, megapixels.
    #[arg(long, env = "RELUME_MAX_PHOTO_MEGAPIXELS", value_parser = clap::value_parser!(u64).range(1..=1000), default_value = "134")]
    max_photo_megapixels: u64,
    /// Maximum size of an environment file: bytes, or a number with MiB, GiB or TiB.
    #[arg(long, env = "RELUME_MAX_ENVIRONMENT_BYTES", value_name = "SIZE", value_parser = storage::size, default_value = "256MiB")]
    max_environment_bytes: u64,
    /// Device for training and rendering: `auto`, `cpu`, `gpu` or `gpu:N`; `relume doctor` lists the devices.
    #[arg(long, env = "RELUME_DEVICE", default_value_t)]
    device: DeviceChoice,
    #[command(flatten)]
    local_workers: local_workers::LocalWorkerArgs,
    /// A job fails after this number of attempts without a new checkpoint.
    #[arg(long, env = "RELUME_MAX_ATTEMPTS", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    max_attempts: u32,
    /// Seconds without a heartbeat after which the server considers a worker dead and gives its job to another worker.
    #[arg(long, env = "RELUME_WORKER_SILENCE", default_value_t = 60, value_parser = clap::value_parser!(u64).range(2..=3600))]
    worker_silence: u64,
    /// Memory budget of all requests together, MiB. Default: half of the memory of the machine or container. A request that does
    /// not fit waits or gets 503; a request that can never fit gets 413.
    #[arg(long = "memory", env = "RELUME_MEMORY", value_name = "MIB", value_parser = clap::value_parser!(u64).range(64..=1 << 24))]
    memory_mib: Option<u64>,
    #[command(flatten)]
    tenant_limits: tenant_limits::TenantLimitArgs,
    #[command(flatten)]
    storage: storage::StorageArgs,
    #[command(flatten)]
    network: network::NetworkArgs,
    #[command(flatten)]
    fetching: fetching::FetchArgs,
    #[command(flatten)]
    poses: poses::ServePosesArgs,
    #[command(flatten)]
    webhooks: webhooks::WebhookArgs,
}

pub(super) fn run(args: ServeArgs) -> CommandResult {
    tokio::runtime::Builder::new_multi_thread().enable_all().build()?.block_on(serve(args))
}

async fn serve(args: ServeArgs) -> CommandResult {
    let mut config = ServerConfig::new(&args.data_dir);
    args.database.apply(&mut config);
    config.api_keys = args.keys.configured()?;
    config.cors_origins = args.cors_origins;
    config.allowed_hosts = args.allowed_hosts;
    config.connections = args.network.limits();
    server::raise_file_limit(config.connections.connections);
    config.limits.capture_bytes = args.max_capture_bytes;
    config.limits.environment_bytes = args.max_environment_bytes;
    if let Some(mib) = args.memory_mib {
        config.limits.memory_bytes = mib << 20;
    }
    args.tenant_limits.apply(&mut config);
    config.limits.disk_bytes = args.storage.max_disk;
    config.thumbnail_cache = args.storage.thumbnail_cache;
    config.artifacts = args.artifacts.place().map(|place| args.storage.bounded(place));
    args.fetching.apply(&mut config);
    args.poses.apply(&mut config);
    args.webhooks.apply(&mut config);
    config.retention = args.storage.retention();
    config.retention_pace = args.storage.retention_pace();
    config.uploads.life = args.storage.upload_life();
    config.worker.device = args.device;
    args.local_workers.apply(&mut config)?;
    config.worker.import_limits.max_image_pixels = args.max_photo_megapixels * 1_000_000;
    config.lease.max_idle_attempts = args.max_attempts;
    config.lease.heartbeat_timeout = Duration::from_secs(args.worker_silence);
    let listener = TcpListener::bind(args.listen).await?;
    // Users and scripts read the address from this line if the port is 0.
    println!("listening on http://{}", listener.local_addr()?);
    let stop = CancellationToken::new();
    let token = stop.clone();
    on_stop(move |request| match request {
        StopRequest::Save => token.cancel(),
        StopRequest::Exit { code } => {
            tracing::warn!(
                "stopped without a new checkpoint; the running job will continue from its last checkpoint"
            );
            std::process::exit(code);
        }
    })?;
    Ok(server::run(config, listener, stop.cancelled_owned()).await?)
}
