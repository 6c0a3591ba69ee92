//! Options for limits per key and tenant.

use crate::cli::serve::storage::size;
use crate::server::ServerConfig;
use crate::store::Quota;

/// Options for limits per key and tenant.
#[derive(Debug, clap::Args)]
pub(super) struct TenantLimitArgs {
    /// Maximum requests of a key per minute. Further requests get 429. Default: not limited.
    #[arg(long, env = "RELUME_REQUESTS_PER_MINUTE", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    requests_per_minute: Option<u32>,
    /// Maximum requests of all keys of a tenant together per minute. Default: ten times the limit of a key.
    #[arg(long, env = "RELUME_REQUESTS_PER_MINUTE_PER_TENANT", value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    requests_per_minute_per_tenant: Option<u32>,
    /// Maximum number of queued and running jobs of a tenant. Further jobs get 429. Default: not limited.
    #[arg(long, env = "RELUME_MAX_JOBS_PER_TENANT", value_parser = clap::value_parser!(u32).range(1..))]
    max_jobs_per_tenant: Option<u32>,
    /// Maximum number of resumable uploads of a tenant that are not yet captures. Further uploads get 429.
    #[arg(long, env = "RELUME_MAX_UPLOADS_PER_TENANT", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..))]
    max_uploads_per_tenant: u32,
    /// Maximum number of queued and running exports of a tenant. Further exports get 429.
    #[arg(long, env = "RELUME_MAX_EXPORTS_PER_TENANT", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..))]
    max_exports_per_tenant: u32,
    /// Maximum total size of a tenant's captures, environments, models, exports and unfinished uploads: bytes, or a number with
    /// MiB, GiB or TiB. Further uploads and jobs get 507. Default: not limited.
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
