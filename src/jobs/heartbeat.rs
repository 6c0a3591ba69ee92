//! Who works: workers say that they are there, and those that fall silent lose their jobs.

use crate::jobs::queue::Jobs;
use crate::store::StoreError;
use relume_api::work::WorkerHello;

/// How long a worker that was not heard of again is remembered, milliseconds.
const FORGET_AFTER_MS: i64 = 24 * 3600 * 1000;

impl Jobs {
    /// Workers that were not seen since are taken for dead; milliseconds since 1970 UTC.
    pub fn heartbeat_cutoff_ms(&self) -> i64 {
        let timeout = i64::try_from(self.policy.heartbeat_timeout.as_millis()).unwrap_or(i64::MAX);
        self.now_ms().saturating_sub(timeout)
    }

    /// How often workers with a job say that they are there, milliseconds.
    pub fn heartbeat_interval_ms(&self) -> u64 {
        u64::try_from(self.policy.heartbeat_timeout.as_millis()).unwrap_or(u64::MAX) / 8
    }

    /// A worker says that it is there; `server`: the data directory whose server it is a thread of. Returns whether it is to end.
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

    /// Forgets the workers that were threads of the server of a data directory before, and excuses the others: nobody could be seen
    /// while it was away.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn reset_worker_registry(&self, server: &str) -> Result<(), StoreError> {
        self.remove_workers(Some(server)).await?;
        self.store.reset_heartbeats(self.now_ms()).await
    }

    /// Forgets workers that were not heard of for a day, and those of a server that ends.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn remove_workers(&self, server: Option<&str>) -> Result<(), StoreError> {
        self.store.remove_workers(server, self.now_ms().saturating_sub(FORGET_AFTER_MS)).await
    }
}
