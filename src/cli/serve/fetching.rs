//! Options about captures that the server fetches.

use crate::server::{FetchOrigin, ServerConfig};

/// Options about captures that the server fetches.
#[derive(Debug, clap::Args)]
pub(super) struct FetchArgs {
    /// Fetch captures from this origin, e.g. `https://scans.example.org`, when a request names a URL there; may be repeated. From
    /// nowhere when absent.
    #[arg(long, env = "RELUME_FETCH_FROM", value_name = "ORIGIN", value_delimiter = ',')]
    fetch_from: Vec<FetchOrigin>,
    /// Fetch also where the address of such an origin is not public, as on this machine and in its network.
    #[arg(long, env = "RELUME_FETCH_ALLOW_PRIVATE")]
    fetch_allow_private: bool,
}

impl FetchArgs {
    pub(super) fn apply(&self, config: &mut ServerConfig) {
        config.fetching.origins.clone_from(&self.fetch_from);
        config.fetching.allow_private = self.fetch_allow_private;
    }
}
