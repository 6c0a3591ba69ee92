//! Options about how much one key or tenant may take.

use crate::cli::serve::storage::size;
use crate::server::ServerConfig;
use crate::store::Quota;

/// Options about how much one key or tenant may take.
#[derive(Debug, clap::Args)]
pub(super) struct TenantLimitArgs {
    /// Requests that a key may make a minute; one more gets 429. Not bounded where absent.
    #[arg(long, env = "RELUME_REQUESTS_PER_MINUTE", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    requests_per_minute: Option<u32>,
    /// Requests that all keys of a tenant together may make a minute. Ten times those of a key where absent.
    #[arg(long, env = "RELUME_REQUESTS_PER_MINUTE_PER_TENANT", value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    requests_per_minute_per_tenant: Option<u32>,
    /// Jobs of a tenant that wait or run; one more gets 429. Not bounded where absent.
    #[arg(long, env = "RELUME_MAX_JOBS_PER_TENANT", value_parser = clap::value_parser!(u32).range(1..))]
    max_jobs_per_tenant: Option<u32>,
    /// Uploads in pieces of a tenant that no capture was made of yet; one more gets 429.
    #[arg(long, env = "RELUME_MAX_UPLOADS_PER_TENANT", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..))]
    max_uploads_per_tenant: u32,
    /// Exports of a tenant that wait or run; one more gets 429.
    #[arg(long, env = "RELUME_MAX_EXPORTS_PER_TENANT", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..))]
    max_exports_per_tenant: u32,
    /// Most that a tenant's captures, environments, models, exports and unfinished uploads take: bytes, or a number with MiB, GiB or TiB; more uploads and jobs get 507. Not bounded where absent.
    #[arg(long, env = "RELUME_MAX_BYTES_PER_TENANT", value_name = "SIZE", value_parser = size)]
    max_bytes_per_tenant: Option<u64>,
}

impl TenantLimitArgs {
    pub(super) fn apply(&self, config: &mut ServerConfig) {
        config.requests_per_minute = self.requests_per_minute;
        config.requests_per_minute_of_tenant = self.requests_per_minute_per_tenant;
        config.uploads.each = self.max_uploads_per_tenant;
        config.exports.each = self.max_exports_per_tenant;
        config.quota = Quota { jobs: self.max_jobs_per_tenant, bytes: self.max_bytes_per_tenant };
    }
}
