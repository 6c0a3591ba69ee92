//! What a worker writes down about an attempt that failed, and that it does write it down.

use crate::worker::job_source::{Claim, JobSourceError};
use crate::worker::thread::{JobOutcome, Worker};
use crate::worker::training::outcome::{AttemptError, stop_attempt};
use relume_api::work::{LeaseStatus, Release, Task};

/// What becomes of a job after an attempt.
enum FailureReport {
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

impl FailureReport {
    /// The report on an attempt that failed.
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

    /// The report on an attempt that panicked.
    fn on_panic(task: &Task) -> Self {
        if task.is_last_attempt {
            let detail = "every attempt ended in an internal error".to_owned();
            Self::Fail { code: "attempts_exhausted", detail }
        } else {
            Self::Release(Release::AttemptFailed)
        }
    }

    async fn write(&self, claim: &dyn Claim) -> Result<(), JobSourceError> {
        let status = match self {
            Self::Release(release) => claim.release(*release).await?,
            Self::Fail { code, detail } => claim.fail(code, detail).await?,
        };
        if status != LeaseStatus::Held {
            stop_attempt(claim).await?;
        }
        Ok(())
    }
}

impl Worker {
    /// Writes down what becomes of a job whose attempt failed.
    pub(super) async fn record_failure(&mut self, claim: &dyn Claim, failure: AttemptError) -> JobOutcome {
        let is_outage = failure.is_outage();
        let ended = self.record(claim, &FailureReport::on(claim.task(), failure)).await;
        if is_outage {
            // Not at once: what was away for this job is so for the next one.
            self.changes.mark_unchanged();
            self.wait().await;
        }
        ended
    }

    /// Writes down what becomes of a job whose attempt panicked.
    pub(super) async fn record_panic(&mut self, claim: &dyn Claim) -> JobOutcome {
        self.record(claim, &FailureReport::on_panic(claim.task())).await
    }

    /// Writes a report, however long that fails: a job that nobody works on must not stay `running`.
    async fn record(&mut self, claim: &dyn Claim, report: &FailureReport) -> JobOutcome {
        let (mut told, job) = (false, &claim.task().job);
        while let Err(error) = report.write(claim).await {
            if self.stop.is_cancelled() {
                tracing::error!(%error, %job, "how a job ended is not recorded; the next start takes it back");
                return JobOutcome::Requeued;
            }
            if !told {
                tracing::error!(%error, %job, "how a job ended cannot be recorded yet");
                told = true;
            }
            self.wait().await;
        }
        match report {
            FailureReport::Release(_) => JobOutcome::Requeued,
            FailureReport::Fail { .. } => JobOutcome::Failed,
        }
    }
}
