//! Options about what is stored and for how long.

use std::time::Duration;

pub(super) use crate::cli::size::size;
use crate::store::{ArtifactsRedirect, ObjectStoreConfig, Retention};

/// Options about what is stored and for how long.
#[derive(Debug, clap::Args)]
pub(super) struct StorageArgs {
    /// Most that is stored: bytes, or a number with MiB, GiB or TiB. Uploads and jobs beyond it get 507. The disk alone is the
    /// limit where absent.
    #[arg(long, env = "RELUME_MAX_DISK", value_name = "SIZE", value_parser = size)]
    pub(super) max_disk: Option<u64>,
    /// Most that rendered thumbnails take in the data directory, beside `--max-disk`: bytes, or a number with MiB, GiB or TiB; 0 keeps
    /// none. Those asked for longest ago go first. Backups leave them out.
    #[arg(long, env = "RELUME_THUMBNAIL_CACHE", value_name = "SIZE", value_parser = size_or_none, default_value = "256MiB")]
    pub(super) thumbnail_cache: u64,
    /// Most that copies of artifacts take in the data directory where `--artifacts` has them: bytes, or a number with MiB, GiB or TiB.
    /// Those used longest ago go first, and none that was used within ten minutes.
    #[arg(long, env = "RELUME_ARTIFACTS_CACHE", value_name = "SIZE", value_parser = size, default_value = "64GiB")]
    artifacts_cache: u64,
    /// Send callers and workers to the object store of `--artifacts` for files, by URLs that are signed for a quarter of an hour, instead of
    /// passing files on. With an endpoint, such as `https://objects.example.com`, where that is another one for them than for the server.
    /// Browsers are served from here all the same.
    #[arg(long, env = "RELUME_ARTIFACTS_REDIRECT", value_name = "ENDPOINT", num_args = 0..=1, require_equals = true,
          default_missing_value = "same", requires = "url", value_parser = redirect)]
    artifacts_redirect: Option<ArtifactsRedirect>,
    /// Days after which a job that has ended is deleted; its model stays. For ever where absent.
    #[arg(long, env = "RELUME_KEEP_JOBS", value_name = "DAYS", value_parser = days)]
    keep_jobs: Option<Duration>,
    /// Days after its upload and its newest job after which a capture is deleted, unless a job may still need it. For ever where
    /// absent.
    #[arg(long, env = "RELUME_KEEP_CAPTURES", value_name = "DAYS", value_parser = days)]
    keep_captures: Option<Duration>,
    /// Days after which a model is deleted. For ever where absent.
    #[arg(long, env = "RELUME_KEEP_MODELS", value_name = "DAYS", value_parser = days)]
    keep_models: Option<Duration>,
    /// Days after which an export that has ended is deleted; it can be made again. For ever where absent.
    #[arg(long, env = "RELUME_KEEP_EXPORTS", value_name = "DAYS", value_parser = days)]
    keep_exports: Option<Duration>,
    /// Days after its last piece after which an upload in pieces is given up that no capture was made of.
    #[arg(long, env = "RELUME_KEEP_UPLOADS", value_name = "DAYS", value_parser = days, default_value = "1")]
    keep_uploads: Duration,
}

impl StorageArgs {
    /// How long unfinished uploads are kept.
    pub(super) fn upload_life(&self) -> Duration {
        self.keep_uploads
    }

    /// An object store of which no more than the bound is kept here.
    pub(super) fn bounded(&self, place: ObjectStoreConfig) -> ObjectStoreConfig {
        ObjectStoreConfig {
            cache_bytes: self.artifacts_cache,
            redirect: self.artifacts_redirect.clone(),
            ..place
        }
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

/// Days, whole or not.
fn days(text: &str) -> Result<Duration, String> {
    let wrong = || "must be days, above 0 and at most 36500".to_owned();
    let days: f64 = text.parse().map_err(|_| wrong())?;
    if days > 0.0 && days <= 36_500.0 { Ok(Duration::from_secs_f64(days * 86_400.0)) } else { Err(wrong()) }
}

/// Where callers find the object store.
fn redirect(text: &str) -> Result<ArtifactsRedirect, String> {
    match text {
        "same" => Ok(ArtifactsRedirect::Same),
        url if url.starts_with("https://") || url.starts_with("http://") => {
            Ok(ArtifactsRedirect::Endpoint(url.to_owned()))
        }
        _ => Err("must be http://HOST or https://HOST, or same".to_owned()),
    }
}

/// As [`size`], or 0.
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
