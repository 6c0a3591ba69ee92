//! Limits of connections.

use std::time::Duration;

/// Open files reserved for the database, artifacts and listeners.
const OTHER_FILES: u64 = 256;

/// Limits of connections. A connection is waiting while it has no request that the server must answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ConnectionLimits {
    /// Maximum number of connections. Another one closes the connection that has waited longest; if none is waiting, it is
    /// refused.
    pub connections: usize,
    /// Maximum number of connections per address. Loopback is not limited, because a proxy may run there.
    pub per_address: usize,
    /// Timeout from the first byte of a request's head to its end.
    pub head: Duration,
    /// Timeout between two requests, and before the first.
    pub idle: Duration,
    /// Timeout between two chunks of a request's body.
    pub body: Duration,
    /// Minimum rate of a request's body after its first minute, bytes per second.
    pub body_rate: u64,
    /// Timeout between two chunks of an answer that the client accepts.
    pub write: Duration,
}

impl Default for ConnectionLimits {
    fn default() -> Self {
        Self {
            connections: 4096,
            per_address: 256,
            head: Duration::from_secs(15),
            // Proxies keep idle connections for 60 seconds. The proxy should close first.
            idle: Duration::from_secs(75),
            body: Duration::from_secs(30),
            body_rate: 1024,
            write: Duration::from_secs(60),
        }
    }
}

impl ConnectionLimits {
    /// The limits, with no more connections than this process can open files for.
    pub(super) fn within_the_file_limit(mut self) -> Self {
        let Ok((files, _)) = rlimit::getrlimit(rlimit::Resource::NOFILE) else { return self };
        let most = usize::try_from(files.saturating_sub(OTHER_FILES)).unwrap_or(usize::MAX).max(1);
        if self.connections > most {
            tracing::warn!(
                files,
                connections = most,
                "the limit of open files allows fewer connections than configured"
            );
            self.connections = most;
        }
        self
    }
}

/// Raises this process's limit of open files to the need of `connections`, up to the hard limit.
pub fn raise_file_limit(connections: usize) {
    let wanted = u64::try_from(connections).unwrap_or(u64::MAX).saturating_add(OTHER_FILES);
    let enough = rlimit::getrlimit(rlimit::Resource::NOFILE).is_ok_and(|(soft, _)| soft >= wanted);
    if !enough && let Err(error) = rlimit::increase_nofile_limit(wanted) {
        tracing::warn!(%error, "cannot raise the limit of open files");
    }
}
