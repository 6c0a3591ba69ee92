//! Options for storage and retention.

use std::time::Duration;

pub(super) use crate::cli::size::size;
use crate::server::RetentionPace;
use crate::store::{ArtifactsRedirect, ObjectStoreConfig, Retention};

/// Options for storage and retention.
#[derive(Debug, clap::Args)]
pub(super) struct StorageArgs {
    /// Maximum total size of stored data: bytes, or a number with MiB, GiB or TiB. Uploads and jobs beyond it get 507. Default:
    /// limited only by the disk.
    #[arg(long, env = "RELUME_MAX_DISK", value_name = "SIZE", value_parser = size)]
    pub(super) max_disk: Option<u64>,
    /// Maximum size of cached thumbnails in the data directory, not counted towards `--max-disk`: bytes, or a number with MiB,
    /// GiB or TiB; 0 disables the cache. The least recently requested thumbnails are removed first. Backups do not contain them.
    #[arg(long, env = "RELUME_THUMBNAIL_CACHE", value_name = "SIZE", value_parser = size_or_none, default_value = "256MiB")]
    pub(super) thumbnail_cache: u64,
    /// Maximum size of the local copies of artifacts if `--artifacts` names an object store: bytes, or a number with MiB, GiB or
    /// TiB. The least recently used copies are removed first; copies used within the last ten minutes are not removed.
    #[arg(long, env = "RELUME_ARTIFACTS_CACHE", value_name = "SIZE", value_parser = size, default_value = "64GiB")]
    artifacts_cache: u64,
    /// Redirect clients and workers to the object store of `--artifacts` for files, by URLs that are signed for 15 minutes,
    /// instead of passing files through the server. ENDPOINT, e.g. `https://objects.example.com`, is the address of the object
    /// store for clients, if it differs from the server's. Browsers are not redirected.
    #[arg(long, env = "RELUME_ARTIFACTS_REDIRECT", value_name = "ENDPOINT", num_args = 0..=1, require_equals = true,
          default_missing_value = "same", requires = "url", value_parser = redirect)]
    artifacts_redirect: Option<ArtifactsRedirect>,
    /// The server deletes a job this number of days after its end; its model is kept. Default: never.
    #[arg(long, env = "RELUME_KEEP_JOBS", value_name = "DAYS", value_parser = days)]
    keep_jobs: Option<Duration>,
    /// The server deletes a capture this number of days after its upload and its newest job, unless a job may still need it.
    /// Default: never.
    #[arg(long, env = "RELUME_KEEP_CAPTURES", value_name = "DAYS", value_parser = days)]
    keep_captures: Option<Duration>,
    /// The server deletes a model this number of days after its creation. Default: never.
    #[arg(long, env = "RELUME_KEEP_MODELS", value_name = "DAYS", value_parser = days)]
    keep_models: Option<Duration>,
    /// The server deletes an export this number of days after its end; it can be made again. Default: never.
    #[arg(long, env = "RELUME_KEEP_EXPORTS", value_name = "DAYS", value_parser = days)]
    keep_exports: Option<Duration>,
    /// Hours after the start of the server, and after a jump of its clock, in which it deletes nothing by age.
    #[arg(long, env = "RELUME_KEEP_DELAY", value_name = "HOURS", value_parser = hours, default_value = "1")]
    keep_delay: Duration,
    /// Maximum share of the jobs, captures, models and exports that the server deletes by age within a day, percent.
    #[arg(long, env = "RELUME_KEEP_DAILY_SHARE", value_name = "PERCENT", value_parser = clap::value_parser!(u8).range(1..=100), default_value = "25")]
    keep_daily_share: u8,
    /// The server deletes an unfinished resumable upload this number of days after its last chunk.
    #[arg(long, env = "RELUME_KEEP_UPLOADS", value_name = "DAYS", value_parser = days, default_value = "1")]
    keep_uploads: Duration,
}

impl StorageArgs {
    /// The retention of unfinished uploads.
    pub(super) fn upload_life(&self) -> Duration {
        self.keep_uploads
    }

    /// The object store with the limits of its cache and the redirects.
    pub(super) fn bounded(&self, place: ObjectStoreConfig) -> ObjectStoreConfig {
        ObjectStoreConfig {
            cache_bytes: self.artifacts_cache,
            redirect: self.artifacts_redirect.clone(),
            ..place
        }
    }

    /// The limits of deletion by age.
    pub(super) fn retention_pace(&self) -> RetentionPace {
        RetentionPace { delay: self.keep_delay, daily_share: f64::from(self.keep_daily_share) / 100.0 }
    }

    pub(super) fn retention(&self) -> Retention {
        Retention {
            jobs: self.keep_jobs,
            captures: self.keep_captures,
            models: self.keep_models,
            exports: self.keep_exports,
        }
    }
}

/// Parses hours; fractions are allowed.
fn hours(text: &str) -> Result<Duration, String> {
    let hours = text.parse().ok().filter(|hours| (0.0..=876_000.0).contains(hours));
    hours
        .map(|hours: f64| Duration::from_secs_f64(hours * 3600.0))
        .ok_or_else(|| "must be hours, 0 to 876000".to_owned())
}

/// Parses days; fractions are allowed.
fn days(text: &str) -> Result<Duration, String> {
    let wrong = || "must be days, above 0 and at most 36500".to_owned();
    let days: f64 = text.parse().map_err(|_| wrong())?;
    if days > 0.0 && days <= 36_500.0 { Ok(Duration::from_secs_f64(days * 86_400.0)) } else { Err(wrong()) }
}

/// Parses the endpoint of the object store for clients.
fn redirect(text: &str) -> Result<ArtifactsRedirect, String> {
    match text {
        "same" => Ok(ArtifactsRedirect::Same),
        url if url.starts_with("https://") || url.starts_with("http://") => {
            Ok(ArtifactsRedirect::Endpoint(url.to_owned()))
        }
        _ => Err("must be http://HOST or https://HOST, or same".to_owned()),
    }
}

/// Parses a size as [`size`] does, or 0.
fn size_or_none(text: &str) -> Result<u64, String> {
    if text.trim() == "0" { Ok(0) } else { size(text) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn storage_options_parse_sizes_days_and_redirect_origins() {
        let read = ["1000", "20GiB", "3 MiB", "2TiB"].map(|text| size(text).unwrap());
        assert_eq!(read, [1000, 20 << 30, 3 << 20, 2 << 40]);
        for wrong in ["", "0", "-1", "GiB", "1.5GiB", "20GB", "99999999999TiB"] {
            assert!(size(wrong).is_err(), "{wrong:?}");
        }
        assert_eq!([size_or_none("0"), size_or_none("3MiB")], [Ok(0), Ok(3 << 20)]);
        assert!(size_or_none("-1").is_err() && size_or_none("0GiB").is_err());
        assert_eq!(redirect("same"), Ok(ArtifactsRedirect::Same));
        assert!(
            redirect("https://o.example").is_ok() && redirect("").is_err() && redirect("o.example").is_err()
        );
        assert_eq!(days("0.5"), Ok(Duration::from_secs(43_200)));
        for wrong in ["", "0", "-1", "NaN", "inf", "40000", "7d"] {
            assert!(days(wrong).is_err(), "{wrong:?}");
        }
    }
}
