//! The policy for webhooks.

use std::time::Duration;

/// The policy for webhooks.
#[derive(Debug, Clone, Copy)]
pub struct WebhookPolicy {
    /// Whether `http://` is permitted in addition to `https://`.
    pub allow_http: bool,
    /// Whether private addresses are permitted.
    pub allow_private: bool,
    /// Timeout from the DNS lookup to the end of the answer.
    pub timeout: Duration,
}

impl Default for WebhookPolicy {
    fn default() -> Self {
        Self { allow_http: false, allow_private: false, timeout: Duration::from_secs(20) }
    }
}
