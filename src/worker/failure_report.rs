//! Records the failure of an attempt and its consequence for the job.

use crate::worker::job_source::{Claim, JobSourceError};
use crate::worker::thread::{JobOutcome, Worker};
use crate::worker::training::outcome::{AttemptError, stop_attempt};
use relume_api::work::{LeaseStatus, Release, Task};

/// The consequence of a failed attempt.
enum FailureReport {
    /// The job is returned to the queue.
    Release(Release),
    /// The job has failed.
    Fail {
        /// Stable code.
        code: &'static str,
        /// A description for the user.
        detail: String,
    },
}

impl FailureReport {
    /// The report for an attempt that failed.
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

    /// The report for an attempt that panicked.
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
    /// Records the failure of an attempt.
    pub(super) async fn record_failure(&mut self, claim: &dyn Claim, failure: AttemptError) -> JobOutcome {
        let is_outage = failure.is_outage();
        let ended = self.record(claim, &FailureReport::on(claim.task(), failure)).await;
        if is_outage {
            // The next claim waits, because the outage also affects the next job.
            self.changes.mark_unchanged();
            self.wait().await;
        }
        ended
    }

    /// Records the panic of an attempt.
    pub(super) async fn record_panic(&mut self, claim: &dyn Claim) -> JobOutcome {
        self.record(claim, &FailureReport::on_panic(claim.task())).await
    }

    /// Records a report and retries until it succeeds, because a job without a worker must not stay `running`.
    async fn record(&mut self, claim: &dyn Claim, report: &FailureReport) -> JobOutcome {
        let (mut told, job) = (false, &claim.task().job);
        while let Err(error) = report.write(claim).await {
            if self.stop.is_cancelled() {
                tracing::error!(%error, %job, "the end of a job is not recorded; the next start of the server reclaims the job");
                return JobOutcome::Requeued;
            }
            if !told {
                tracing::error!(%error, %job, "the end of a job cannot be recorded yet; retrying");
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
