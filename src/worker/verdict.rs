//! What a worker writes down about an attempt that failed, and that it does write it down.

use crate::api::work::{LeaseStatus, Release, Task};
use crate::worker::source::{Claim, SourceError};
use crate::worker::thread::{Ended, Worker};
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
    fn on(task: &Task, failure: AttemptError) -> Self {
        if failure.is_shortage() {
            Self::Release(Release::NoRoom)
        } else if failure.is_outage() {
            Self::Release(Release::Outage)
        } else if failure.is_device_failure() && !task.is_last_attempt {
            Self::Release(Release::AttemptFailed)
        } else {
            Self::Fail { code: failure.code, detail: failure.detail }
        }
    }

    /// The verdict on an attempt that panicked.
    fn on_panic(task: &Task) -> Self {
        if task.is_last_attempt {
            let detail = "every attempt ended in an internal error".to_owned();
            Self::Fail { code: "attempts_exhausted", detail }
        } else {
            Self::Release(Release::AttemptFailed)
        }
    }

    async fn write(&self, claim: &dyn Claim) -> Result<(), SourceError> {
        let status = match self {
            Self::Release(release) => claim.release(*release).await?,
            Self::Fail { code, detail } => claim.fail(code, detail).await?,
        };
        if status != LeaseStatus::Held {
            settle(claim).await?;
        }
        Ok(())
    }
}

impl Worker {
    /// Writes down what becomes of a job whose attempt failed.
    pub(super) async fn record_failure(&mut self, claim: &dyn Claim, failure: AttemptError) -> Ended {
        let is_outage = failure.is_outage();
        let ended = self.record(claim, &Verdict::on(claim.task(), failure)).await;
        if is_outage {
            // Not at once: what was away for this job is so for the next one.
            self.changes.mark_unchanged();
            self.wait().await;
        }
        ended
    }

    /// Writes down what becomes of a job whose attempt panicked.
    pub(super) async fn record_panic(&mut self, claim: &dyn Claim) -> Ended {
        self.record(claim, &Verdict::on_panic(claim.task())).await
    }

    /// Writes a verdict, however long that fails: a job that nobody works on must not stay `running`.
    async fn record(&mut self, claim: &dyn Claim, verdict: &Verdict) -> Ended {
        let (mut told, job) = (false, &claim.task().job);
        while let Err(error) = verdict.write(claim).await {
            if self.stop.is_cancelled() {
                tracing::error!(%error, %job, "how a job ended is not recorded; the next start takes it back");
                return Ended::GivenBack;
            }
            if !told {
                tracing::error!(%error, %job, "how a job ended cannot be recorded yet");
                told = true;
            }
            self.wait().await;
        }
        match verdict {
            Verdict::Release(_) => Ended::GivenBack,
            Verdict::Fail { .. } => Ended::Failed,
        }
    }
}
