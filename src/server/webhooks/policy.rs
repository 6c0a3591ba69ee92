//! What webhooks may do.

use std::time::Duration;

/// What webhooks may do.
#[derive(Debug, Clone, Copy)]
pub struct WebhookPolicy {
    /// Whether `http://` is accepted beside `https://`.
    pub allow_http: bool,
    /// Whether addresses that are not public are accepted.
    pub allow_private: bool,
    /// From looking up the address to the end of the answer.
    pub timeout: Duration,
}

impl Default for WebhookPolicy {
    fn default() -> Self {
        Self { allow_http: false, allow_private: false, timeout: Duration::from_secs(20) }
    }
}
