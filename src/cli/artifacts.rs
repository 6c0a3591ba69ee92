//! Options for an object store that holds the artifacts.

use crate::store::{ArtifactsUrl, ObjectStoreConfig};

/// Options for the object store.
#[derive(Debug, clap::Args)]
pub(super) struct ArtifactsArgs {
    /// Object store for captures, models and all other artifacts: `s3://BUCKET/PREFIX`, `gs://BUCKET/PREFIX` or
    /// `az://CONTAINER/PREFIX`. The data directory is then a cache. Credentials and endpoint come from the environment, e.g.
    /// AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION, AWS_ENDPOINT_URL.
    #[arg(long = "artifacts", env = "RELUME_ARTIFACTS", value_name = "URL")]
    url: Option<ArtifactsUrl>,
}

impl ArtifactsArgs {
    /// The configuration of the object store, with the settings of the environment.
    pub(super) fn place(&self) -> Option<ObjectStoreConfig> {
        self.url.clone().map(ObjectStoreConfig::from_env)
    }
}
