//! Heartbeats of workers. Workers without heartbeats lose their jobs.

use crate::jobs::queue::Jobs;
use crate::store::StoreError;
use relume_api::work::WorkerHello;

/// Time after its last heartbeat for which a worker is kept in the registry, milliseconds.
const FORGET_AFTER_MS: i64 = 24 * 3600 * 1000;

impl Jobs {
    /// Workers whose last heartbeat is before this time are considered dead; milliseconds since 1970 UTC.
    pub fn heartbeat_cutoff_ms(&self) -> i64 {
        let timeout = i64::try_from(self.policy.heartbeat_timeout.as_millis()).unwrap_or(i64::MAX);
        self.now_ms().saturating_sub(timeout)
    }

    /// Interval of the heartbeats of workers with a job, milliseconds.
    pub fn heartbeat_interval_ms(&self) -> u64 {
        u64::try_from(self.policy.heartbeat_timeout.as_millis()).unwrap_or(u64::MAX) / 8
    }

    /// Records a heartbeat of a worker. `server` is the data directory of the server of a local worker. Returns whether the
    /// worker is draining.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn record_worker_heartbeat(
        &self,
        hello: &WorkerHello,
        server: Option<&str>,
    ) -> Result<bool, StoreError> {
        self.store.record_worker_heartbeat(hello, server, self.now_ms()).await
    }

    /// Removes the earlier local workers of the server of a data directory, and renews the heartbeats of the others, because none
    /// could arrive while the server was stopped.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn reset_worker_registry(&self, server: &str) -> Result<(), StoreError> {
        self.remove_workers(Some(server)).await?;
        self.store.reset_heartbeats(self.now_ms()).await
    }

    /// Removes workers without a heartbeat for a day, and the local workers of `server`, which ends.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn remove_workers(&self, server: Option<&str>) -> Result<(), StoreError> {
        self.store.remove_workers(server, self.now_ms().saturating_sub(FORGET_AFTER_MS)).await
    }
}
