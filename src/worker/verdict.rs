//! What a worker writes down about an attempt that failed, and that it does write it down.

use crate::jobs::Lease;
use crate::store::{LeaseStatus, Release, StoreError};
use crate::worker::thread::Worker;
use crate::worker::training::outcome::{AttemptError, settle};

/// What becomes of a job after an attempt.
enum Verdict {
    /// It goes back to the queue.
    Release(Release),
    /// It has failed.
    Fail {
        /// Stable code.
        code: &'static str,
        /// A description for the user.
        detail: String,
    },
}

impl Verdict {
    /// The verdict on an attempt that failed.
    fn on(lease: &Lease, failure: AttemptError) -> Self {
        if failure.is_shortage() {
            Self::Release(Release::NoRoom)
        } else if failure.is_outage() {
            Self::Release(Release::Outage)
        } else if failure.is_device_failure() && !lease.is_last_attempt() {
            Self::Release(Release::AttemptFailed)
        } else {
            Self::Fail { code: failure.code, detail: failure.detail }
        }
    }

    /// The verdict on an attempt that panicked.
    fn on_panic(lease: &Lease) -> Self {
        if lease.is_last_attempt() {
            let detail = "every attempt ended in an internal error".to_owned();
            Self::Fail { code: "attempts_exhausted", detail }
        } else {
            Self::Release(Release::AttemptFailed)
        }
    }

    async fn write(&self, lease: &Lease) -> Result<(), StoreError> {
        let status = match self {
            Self::Release(release) => lease.release(*release).await?,
            Self::Fail { code, detail } => lease.fail(code, detail).await?,
        };
        if status != LeaseStatus::Held {
            settle(lease).await?;
        }
        Ok(())
    }
}

impl Worker {
    /// Writes down what becomes of a job whose attempt failed.
    pub(super) async fn record_failure(&mut self, lease: &Lease, failure: AttemptError) {
        self.record(lease, &Verdict::on(lease, failure)).await;
    }

    /// Writes down what becomes of a job whose attempt panicked.
    pub(super) async fn record_panic(&mut self, lease: &Lease) {
        self.record(lease, &Verdict::on_panic(lease)).await;
    }

    /// Writes a verdict, however long the store fails: a job that nobody works on must not stay `running`. On a full disk the
    /// reserve is given up for it.
    async fn record(&mut self, lease: &Lease, verdict: &Verdict) {
        let mut told = false;
        while let Err(error) = verdict.write(lease).await {
            let room = self.jobs.store().room().clone();
            if matches!(error, StoreError::Full) {
                room.note_shortage(1);
                if room.spend_reserve() {
                    continue;
                }
            }
            if self.stop.is_cancelled() {
                tracing::error!(%error, job = %lease.job().id, "how a job ended is not recorded; the next start takes it back");
                return;
            }
            if !told {
                tracing::error!(%error, job = %lease.job().id, "how a job ended cannot be recorded yet");
                told = true;
            }
            self.wait().await;
        }
    }

    /// True while there is less room than the last write that did not fit would need. Nothing is claimed then.
    pub(super) async fn lacks_room(&self) -> bool {
        let store = self.jobs.store();
        if !store.room().is_short() {
            return false;
        }
        if let Ok(false) = self.jobs.any_waits().await {
            store.room().forget_shortage();
        }
        match store.check_room().await {
            Ok(()) => {
                tracing::info!("there is room on the disk again");
                false
            }
            Err(error) => {
                tracing::debug!(%error, "jobs wait for room");
                true
            }
        }
    }
}
