//! Options for captures that the server fetches.

use crate::server::{FetchOrigin, ServerConfig};

/// Options for captures that the server fetches.
#[derive(Debug, clap::Args)]
pub(super) struct FetchArgs {
    /// Origins from which the server may fetch captures, e.g. `https://scans.example.org`, separated by commas; repeatable. The
    /// server fetches a capture if a request names a URL there. Default: none.
    #[arg(long, env = "RELUME_FETCH_FROM", value_name = "ORIGIN", value_delimiter = ',')]
    fetch_from: Vec<FetchOrigin>,
    /// Fetch captures also from origins whose address is not public, such as loopback and private networks.
    #[arg(long, env = "RELUME_FETCH_ALLOW_PRIVATE")]
    fetch_allow_private: bool,
}

impl FetchArgs {
    pub(super) fn apply(&self, config: &mut ServerConfig) {
        config.fetching.origins.clone_from(&self.fetch_from);
        config.fetching.allow_private = self.fetch_allow_private;
    }
}
