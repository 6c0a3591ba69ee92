//! Where artifacts are when they are not in the data directory alone.

use crate::store::{ArtifactsUrl, ObjectStoreConfig};

/// Where artifacts are.
#[derive(Debug, clap::Args)]
pub(super) struct ArtifactsArgs {
    /// `s3://BUCKET/PREFIX`, `gs://BUCKET/PREFIX` or `az://CONTAINER/PREFIX`: an object store that has captures, models and all else
    /// that is made, of which the data directory is a cache then. Credentials and endpoint are those of the environment, e.g.
    /// AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION, AWS_ENDPOINT_URL.
    #[arg(long = "artifacts", env = "RELUME_ARTIFACTS", value_name = "URL")]
    url: Option<ArtifactsUrl>,
}

impl ArtifactsArgs {
    /// The object store, with the settings of the environment.
    pub(super) fn place(&self) -> Option<ObjectStoreConfig> {
        self.url.clone().map(ObjectStoreConfig::from_env)
    }
}
