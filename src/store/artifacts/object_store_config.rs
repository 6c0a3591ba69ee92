//! Configuration of the object store and its local cache.

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

/// Timeout of a connection attempt.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// Time during which a failed request is retried.
const RETRY_TIMEOUT: Duration = Duration::from_secs(10);
/// Timeout without new bytes of a response.
const STALL_TIMEOUT: Duration = Duration::from_secs(30);
/// Time for which a used copy is kept, independent of the size limit, so that the caller can open it.
const CACHE_MIN_AGE: Duration = Duration::from_secs(600);
/// Default size limit of the local copies, bytes.
const DEFAULT_CACHE_BYTES: u64 = 64 << 30;
/// Size of a part of a multipart upload, bytes.
const DEFAULT_PART_BYTES: usize = 8 << 20;

/// The interface of an object store.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Provider {
    S3,
    Google,
    Azure,
}

/// The bucket of an object store and the prefix of all keys in it: `s3://BUCKET/PREFIX`, `gs://BUCKET/PREFIX` or
/// `az://CONTAINER/PREFIX`. Each database requires its own prefix.
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

/// Location of the object store, timeouts, and size of the local cache.
#[derive(Clone)]
pub struct ObjectStoreConfig {
    /// The location.
    pub url: ArtifactsUrl,
    /// Size limit of the local copies, bytes. The least recently used copies are removed first.
    pub cache_bytes: u64,
    /// Time for which a used copy is kept, independent of the size limit.
    pub cache_min_age: Duration,
    /// Time during which a failed request is retried.
    pub retry_timeout: Duration,
    /// Timeout without new bytes of a response.
    pub stall_timeout: Duration,
    /// Size of a part of a multipart upload, bytes; at least 5 MiB.
    pub part_bytes: usize,
    /// Credentials and endpoint, by the names of environment variables.
    pub settings: Vec<(String, String)>,
    /// Whether callers are redirected to the object store by signed URLs, and its endpoint for them.
    pub redirect: Option<ArtifactsRedirect>,
}

/// The endpoint of the object store for callers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ArtifactsRedirect {
    /// The endpoint that the server uses.
    Same,
    /// Another endpoint, such as `https://objects.example.com`.
    Endpoint(String),
}

/// The client of an object store, and its signer of URLs.
pub(super) struct ObjectStoreClient {
    pub(super) objects: Arc<dyn ObjectStore>,
    pub(super) signer: Arc<dyn Signer>,
}

impl ObjectStoreConfig {
    /// A configuration with `settings` by the names of environment variables: `AWS_...`, `GOOGLE_...` and `AZURE_...`.
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

    /// A configuration with the settings of the environment.
    pub fn from_env(url: ArtifactsUrl) -> Self {
        Self::new(
            url,
            std::env::vars_os().filter_map(|(k, v)| Some((k.into_string().ok()?, v.into_string().ok()?))),
        )
    }

    /// The prefix of all keys.
    pub(super) fn prefix(&self) -> &Key {
        &self.url.prefix
    }

    /// The signer of URLs, if callers are redirected.
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
                // The last value applies.
                there.settings.push((name.to_owned(), endpoint.clone()));
            }
        }
        Ok(Some(there.connect()?.signer))
    }

    /// Creates the client. Sends no request yet.
    ///
    /// # Errors
    /// If a setting is missing or invalid.
    pub(super) fn connect(&self) -> object_store::Result<ObjectStoreClient> {
        // If the process already has a crypto provider, that one is used.
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
