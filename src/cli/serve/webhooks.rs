//! Options for webhooks.

use crate::server::ServerConfig;

/// Options for webhooks.
#[derive(Debug, clap::Args)]
pub(super) struct WebhookArgs {
    /// Accept webhook URLs with `http://`. Such messages are not encrypted.
    #[arg(long, env = "RELUME_WEBHOOK_ALLOW_HTTP")]
    webhook_allow_http: bool,
    /// Accept webhook URLs whose address is not public, such as loopback and private networks. Callers that can create webhooks
    /// can then make the server send requests to these addresses.
    #[arg(long, env = "RELUME_WEBHOOK_ALLOW_PRIVATE")]
    webhook_allow_private: bool,
}

impl WebhookArgs {
    pub(super) fn apply(&self, config: &mut ServerConfig) {
        config.webhooks.allow_http = self.webhook_allow_http;
        config.webhooks.allow_private = self.webhook_allow_private;
    }
}
