//! Options for connections.

use std::time::Duration;

use crate::server::ConnectionLimits;

/// Options for connections.
#[derive(Debug, clap::Args)]
pub(super) struct NetworkArgs {
    /// Maximum number of open connections. At this number, a new connection replaces the one that has
    /// waited longest for its client.
    #[arg(long, env = "RELUME_MAX_CONNECTIONS", default_value_t = 4096, value_parser = count)]
    max_connections: usize,
    /// Maximum number of open connections per address. Loopback is not limited. Increase it if a proxy on another machine
    /// forwards the requests of all clients.
    #[arg(long, env = "RELUME_MAX_CONNECTIONS_PER_ADDRESS", default_value_t = 256, value_parser = count)]
    max_connections_per_address: usize,
    /// Timeout from the first byte of a request's head to its end, seconds.
    #[arg(long, env = "RELUME_HEAD_TIMEOUT", default_value = "15", value_parser = seconds)]
    head_timeout: Duration,
    /// Timeout of an idle connection, seconds. Must exceed the idle timeout of a proxy.
    #[arg(long, env = "RELUME_IDLE_TIMEOUT", default_value = "75", value_parser = seconds)]
    idle_timeout: Duration,
    /// Timeout between bytes of a request's body, seconds.
    #[arg(long, env = "RELUME_BODY_TIMEOUT", default_value = "30", value_parser = seconds)]
    body_timeout: Duration,
    /// Minimum rate of a request's body after its first minute, bytes per second. 0: no minimum. The total time of an upload is not limited.
    #[arg(long, env = "RELUME_MIN_BODY_RATE", default_value_t = 1024)]
    min_body_rate: u64,
    /// Timeout for a client to accept more bytes of its response, seconds.
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
            body_rate: self.min_body_rate,
            write: self.write_timeout,
        }
    }
}

/// Parses a number of connections.
fn count(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|n| (1..=1_000_000).contains(n)).ok_or_else(|| "must be 1 to 1000000".to_owned())
}

/// Parses seconds; fractions are allowed.
fn seconds(text: &str) -> Result<Duration, String> {
    let wrong = || "must be seconds, above 0 and at most 86400".to_owned();
    let seconds: f64 = text.parse().map_err(|_| wrong())?;
    if seconds > 0.0 && seconds <= 86_400.0 { Ok(Duration::from_secs_f64(seconds)) } else { Err(wrong()) }
}
