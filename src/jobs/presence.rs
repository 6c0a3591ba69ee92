//! Who works: workers say that they are there, and those that fall silent lose their jobs.

use crate::api::work::WorkerHello;
use crate::jobs::queue::Jobs;
use crate::store::StoreError;

/// How long a worker that was not heard of again is remembered, milliseconds.
const REMEMBERED: i64 = 24 * 3600 * 1000;

impl Jobs {
    /// Workers that were not seen since are taken for dead; milliseconds since 1970 UTC.
    pub fn alive_ms(&self) -> i64 {
        let silence = i64::try_from(self.policy.worker_silence.as_millis()).unwrap_or(i64::MAX);
        self.now_ms().saturating_sub(silence)
    }

    /// How often workers with a job say that they are there, milliseconds.
    pub fn beat_ms(&self) -> u64 {
        u64::try_from(self.policy.worker_silence.as_millis()).unwrap_or(u64::MAX) / 8
    }

    /// A worker says that it is there; `server`: the data directory whose server it is a thread of. Returns whether it is to end.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn note_worker(&self, hello: &WorkerHello, server: Option<&str>) -> Result<bool, StoreError> {
        self.store.note_worker(hello, server, self.now_ms()).await
    }

    /// Forgets the workers that were threads of the server of a data directory before, and excuses the others: nobody could be seen
    /// while it was away.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn begin_roll_call(&self, server: &str) -> Result<(), StoreError> {
        self.forget_workers(Some(server)).await?;
        self.store.excuse_workers(self.now_ms()).await
    }

    /// Forgets workers that were not heard of for a day, and those of a server that ends.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn forget_workers(&self, server: Option<&str>) -> Result<(), StoreError> {
        self.store.forget_workers(server, self.now_ms().saturating_sub(REMEMBERED)).await
    }
}
