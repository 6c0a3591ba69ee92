//! Where artifacts are that other machines read, too, and how it is reached.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::azure::{AzureConfigKey, MicrosoftAzureBuilder};
use object_store::gcp::{GoogleCloudStorageBuilder, GoogleConfigKey};
use object_store::path::Path as Key;
use object_store::signer::Signer;
use object_store::{ClientOptions, ObjectStore, RetryConfig};

/// How long a connection may take.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// How long a request is tried again.
const RETRY_TIMEOUT: Duration = Duration::from_secs(10);
/// How long an answer may bring nothing.
const STALL_TIMEOUT: Duration = Duration::from_secs(30);
/// How long a copy stays that was used, however small the bound: whoever asked for it opens it meanwhile.
const CACHE_MIN_AGE: Duration = Duration::from_secs(600);
/// Bytes of copies unless another bound is given.
const DEFAULT_CACHE_BYTES: u64 = 64 << 30;
/// Bytes that are sent in one request.
const DEFAULT_PART_BYTES: usize = 8 << 20;

/// Whose interface an object store has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Provider {
    S3,
    Google,
    Azure,
}

/// The bucket of an object store, and what all names in it begin with: `s3://BUCKET/PREFIX`, `gs://BUCKET/PREFIX` or
/// `az://CONTAINER/PREFIX`. One for each database.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ArtifactsUrl {
    kind: Provider,
    bucket: String,
    prefix: Key,
}

impl FromStr for ArtifactsUrl {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let wrong = || "must be s3://BUCKET/PREFIX, gs://BUCKET/PREFIX or az://CONTAINER/PREFIX".to_owned();
        let (scheme, rest) = text.split_once("://").ok_or_else(wrong)?;
        let kind = match scheme {
            "s3" => Provider::S3,
            "gs" => Provider::Google,
            "az" => Provider::Azure,
            _ => return Err(wrong()),
        };
        let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
        let is_name = |c: char| c.is_ascii_alphanumeric() || "-._".contains(c);
        if bucket.is_empty() || !bucket.chars().all(is_name) {
            return Err(wrong());
        }
        let prefix = Key::parse(prefix).map_err(|error| format!("the prefix cannot be used: {error}"))?;
        Ok(Self { kind, bucket: bucket.to_owned(), prefix })
    }
}

impl fmt::Display for ArtifactsUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scheme = match self.kind {
            Provider::S3 => "s3",
            Provider::Google => "gs",
            Provider::Azure => "az",
        };
        write!(f, "{scheme}://{}/{}", self.bucket, self.prefix)
    }
}

/// An object store for artifacts, how patient its users are, and how much of it is kept on this machine.
#[derive(Clone)]
pub struct ObjectStoreConfig {
    /// Where it is.
    pub url: ArtifactsUrl,
    /// Bytes of copies on this machine; those used longest ago go first.
    pub cache_bytes: u64,
    /// How long a copy stays that was used, however small the bound.
    pub cache_min_age: Duration,
    /// How long a request is tried again.
    pub retry_timeout: Duration,
    /// How long an answer may bring nothing.
    pub stall_timeout: Duration,
    /// Bytes that are sent in one request; 5 MiB at least.
    pub part_bytes: usize,
    /// Credentials and endpoint, by the names of environment variables.
    pub settings: Vec<(String, String)>,
    /// Whether callers are sent there for files, by URLs that are signed for them, and where it is for them.
    pub redirect: Option<ArtifactsRedirect>,
}

/// Where the object store is for those who are sent there.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ArtifactsRedirect {
    /// Where it is for the server.
    Same,
    /// At another endpoint, such as `https://objects.example.com`.
    Endpoint(String),
}

/// An object store, and what makes URLs that let their holder in.
pub(super) struct ObjectStoreClient {
    pub(super) objects: Arc<dyn ObjectStore>,
    pub(super) signer: Arc<dyn Signer>,
}

impl ObjectStoreConfig {
    /// With `settings` by the names of environment variables: `AWS_...`, `GOOGLE_...` and `AZURE_...`.
    pub fn new(url: ArtifactsUrl, settings: impl IntoIterator<Item = (String, String)>) -> Self {
        Self {
            url,
            cache_bytes: DEFAULT_CACHE_BYTES,
            cache_min_age: CACHE_MIN_AGE,
            retry_timeout: RETRY_TIMEOUT,
            stall_timeout: STALL_TIMEOUT,
            part_bytes: DEFAULT_PART_BYTES,
            settings: settings.into_iter().collect(),
            redirect: None,
        }
    }

    /// With the settings of the environment.
    pub fn from_env(url: ArtifactsUrl) -> Self {
        Self::new(
            url,
            std::env::vars_os().filter_map(|(k, v)| Some((k.into_string().ok()?, v.into_string().ok()?))),
        )
    }

    /// What all names begin with.
    pub(super) fn prefix(&self) -> &Key {
        &self.url.prefix
    }

    /// What signs URLs for callers, if they are sent there.
    ///
    /// # Errors
    /// As [`Self::connect`].
    pub(super) fn signer(&self) -> object_store::Result<Option<Arc<dyn Signer>>> {
        let mut there = self.clone();
        match &self.redirect {
            None => return Ok(None),
            Some(ArtifactsRedirect::Same) => {}
            Some(ArtifactsRedirect::Endpoint(endpoint)) => {
                let name = match self.url.kind {
                    Provider::S3 => "AWS_ENDPOINT_URL",
                    Provider::Google => "GOOGLE_BASE_URL",
                    Provider::Azure => "AZURE_STORAGE_ENDPOINT",
                };
                // The last one counts.
                there.settings.push((name.to_owned(), endpoint.clone()));
            }
        }
        Ok(Some(there.connect()?.signer))
    }

    /// Nothing is asked yet.
    ///
    /// # Errors
    /// When a setting is missing or wrong.
    pub(super) fn connect(&self) -> object_store::Result<ObjectStoreClient> {
        // Another provider of the process is as good.
        tokio_rustls::rustls::crypto::ring::default_provider().install_default().ok();
        let client = ClientOptions::new()
            .with_timeout_disabled()
            .with_connect_timeout(CONNECT_TIMEOUT)
            .with_read_timeout(self.stall_timeout);
        let retry = RetryConfig { retry_timeout: self.retry_timeout, ..RetryConfig::default() };
        macro_rules! built {
            ($builder:ty, $key:ty, $prefix:literal, $bucket:ident) => {{
                let builder = <$builder>::new().with_client_options(client).with_retry(retry);
                let of_this = self.settings.iter().filter(|(name, _)| name.starts_with($prefix));
                let builder = of_this.fold(builder, |builder, (name, value)| {
                    match name.to_ascii_lowercase().parse::<$key>() {
                        Ok(key) => builder.with_config(key, value),
                        Err(_) => builder,
                    }
                });
                let store = Arc::new(builder.$bucket(&self.url.bucket).build()?);
                ObjectStoreClient { objects: store.clone(), signer: store }
            }};
        }
        Ok(match self.url.kind {
            Provider::S3 => built!(AmazonS3Builder, AmazonS3ConfigKey, "AWS_", with_bucket_name),
            Provider::Google => {
                built!(GoogleCloudStorageBuilder, GoogleConfigKey, "GOOGLE_", with_bucket_name)
            }
            Provider::Azure => built!(MicrosoftAzureBuilder, AzureConfigKey, "AZURE_", with_container_name),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn object_store_urls_have_kind_bucket_and_prefix() {
        for (text, kind, bucket, prefix) in [
            ("s3://models", Provider::S3, "models", ""),
            ("s3://models/relume/prod", Provider::S3, "models", "relume/prod"),
            ("gs://m.example/x/", Provider::Google, "m.example", "x"),
            ("az://box/a", Provider::Azure, "box", "a"),
        ] {
            let url: ArtifactsUrl = text.parse().unwrap();
            assert_eq!((url.kind, url.bucket.as_str(), url.prefix.as_ref()), (kind, bucket, prefix));
            assert_eq!(url.to_string().parse::<ArtifactsUrl>().unwrap(), url);
        }
        for wrong in [
            "models",
            "s3:/models",
            "s3:///x",
            "file:///tmp",
            "http://h/x",
            "s3://a b",
            "s3://k:s@m/x",
            "s3://m/a//b",
        ] {
            assert!(wrong.parse::<ArtifactsUrl>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn only_settings_of_the_selected_object_store_are_checked() {
        let place = |text: &str, settings: &[(&str, &str)]| {
            let settings = settings.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned()));
            ObjectStoreConfig::new(text.parse().unwrap(), settings).connect()
        };
        let keys = [("AWS_ACCESS_KEY_ID", "k"), ("AWS_SECRET_ACCESS_KEY", "s"), ("AZURE_ENDPOINT", "\u{0}")];
        place("s3://models", &keys).unwrap();
        assert!(place("az://models", &keys).is_err(), "it has no account");
    }
}
