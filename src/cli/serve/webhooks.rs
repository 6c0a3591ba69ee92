//! Options about webhooks.

use crate::server::ServerConfig;

/// Options about webhooks.
#[derive(Debug, clap::Args)]
pub(super) struct WebhookArgs {
    /// Accept webhooks at `http://`, where anybody on the way reads them.
    #[arg(long, env = "RELUME_WEBHOOK_ALLOW_HTTP")]
    webhook_allow_http: bool,
    /// Accept webhooks at addresses that are not public, as on this machine and in its network: whoever may make webhooks then
    /// makes the server send requests there.
    #[arg(long, env = "RELUME_WEBHOOK_ALLOW_PRIVATE")]
    webhook_allow_private: bool,
}

impl WebhookArgs {
    pub(super) fn apply(&self, config: &mut ServerConfig) {
        config.webhooks.allow_http = self.webhook_allow_http;
        config.webhooks.allow_private = self.webhook_allow_private;
    }
}
