//! Bounds on connections.

use std::time::Duration;

/// Files that are left for the database, artifacts and listeners.
const OTHER_FILES: u64 = 256;

/// Bounds on connections. A connection waits while the server has no request of it to answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ConnectionLimits {
    /// Connections in all. One more closes the one that has waited longest; if none waits, it is turned away.
    pub connections: usize,
    /// Connections of one address; loopback, where a proxy would stand, is not counted.
    pub per_address: usize,
    /// From the first byte of a request's head to its end.
    pub head: Duration,
    /// Between two requests, and before the first.
    pub idle: Duration,
    /// Between two pieces of a request's body.
    pub body: Duration,
    /// Between two pieces of an answer that the client takes.
    pub write: Duration,
}

impl Default for ConnectionLimits {
    fn default() -> Self {
        Self {
            connections: 4096,
            per_address: 256,
            head: Duration::from_secs(15),
            // Proxies keep theirs for 60 seconds; the side that closes first should be theirs.
            idle: Duration::from_secs(75),
            body: Duration::from_secs(30),
            write: Duration::from_secs(60),
        }
    }
}

impl ConnectionLimits {
    /// With no more connections than this process may open files for.
    pub(super) fn within_the_file_limit(mut self) -> Self {
        let Ok((files, _)) = rlimit::getrlimit(rlimit::Resource::NOFILE) else { return self };
        let most = usize::try_from(files.saturating_sub(OTHER_FILES)).unwrap_or(usize::MAX).max(1);
        if self.connections > most {
            tracing::warn!(files, connections = most, "the limit of open files allows fewer connections");
            self.connections = most;
        }
        self
    }
}

/// Raises this process's limit of open files to what `connections` need, as far as the hard limit allows.
pub fn raise_file_limit(connections: usize) {
    let wanted = u64::try_from(connections).unwrap_or(u64::MAX).saturating_add(OTHER_FILES);
    let enough = rlimit::getrlimit(rlimit::Resource::NOFILE).is_ok_and(|(soft, _)| soft >= wanted);
    if !enough && let Err(error) = rlimit::increase_nofile_limit(wanted) {
        tracing::warn!(%error, "the limit of open files cannot be raised");
    }
}
