//! Options about connections.

use std::time::Duration;

use crate::server::ConnectionLimits;

/// Options about connections.
#[derive(Debug, clap::Args)]
pub(super) struct NetworkArgs {
    /// Most open connections; one more closes the one that has waited longest for its client.
    #[arg(long, env = "RELUME_MAX_CONNECTIONS", default_value_t = 4096, value_parser = count)]
    max_connections: usize,
    /// Most open connections of one address; loopback is not counted. Raise it where a proxy on another machine stands
    /// before all clients.
    #[arg(long, env = "RELUME_MAX_CONNECTIONS_PER_ADDRESS", default_value_t = 256, value_parser = count)]
    max_connections_per_address: usize,
    /// Seconds from the first byte of a request's head to its end.
    #[arg(long, env = "RELUME_HEAD_TIMEOUT", default_value = "15", value_parser = seconds)]
    head_timeout: Duration,
    /// Seconds that a connection may idle. Keep it above the idle timeout of a proxy.
    #[arg(long, env = "RELUME_IDLE_TIMEOUT", default_value = "75", value_parser = seconds)]
    idle_timeout: Duration,
    /// Seconds without a byte of a request's body; an upload may take as long as it flows.
    #[arg(long, env = "RELUME_BODY_TIMEOUT", default_value = "30", value_parser = seconds)]
    body_timeout: Duration,
    /// Seconds in which a client takes no byte of its answer.
    #[arg(long, env = "RELUME_WRITE_TIMEOUT", default_value = "60", value_parser = seconds)]
    write_timeout: Duration,
}

impl NetworkArgs {
    pub(super) fn limits(&self) -> ConnectionLimits {
        ConnectionLimits {
            connections: self.max_connections,
            per_address: self.max_connections_per_address,
            head: self.head_timeout,
            idle: self.idle_timeout,
            body: self.body_timeout,
            write: self.write_timeout,
        }
    }
}

/// A number of connections.
fn count(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|n| (1..=1_000_000).contains(n)).ok_or_else(|| "must be 1 to 1000000".to_owned())
}

/// Seconds, whole or not.
fn seconds(text: &str) -> Result<Duration, String> {
    let wrong = || "must be seconds, above 0 and at most 86400".to_owned();
    let seconds: f64 = text.parse().map_err(|_| wrong())?;
    if seconds > 0.0 && seconds <= 86_400.0 { Ok(Duration::from_secs_f64(seconds)) } else { Err(wrong()) }
}
