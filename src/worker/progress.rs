//! From step reports to progress events: at most two a second, each with the expected time to the end.

use crate::api::jobs::JobProgress;
use crate::jobs::Lease;
use crate::store::StoreError;
use crate::train::{Progress, StepReport};

/// Least time between two progress events.
const INTERVAL_MS: i64 = 500;

/// Decides when progress is reported.
pub(super) struct Reporter {
    started_ms: i64,
    first_step: u32,
    reported_ms: i64,
}

impl Reporter {
    /// `first_step`: steps that earlier attempts did.
    pub(super) fn new(now_ms: i64, first_step: u32) -> Self {
        Self { started_ms: now_ms, first_step, reported_ms: i64::MIN }
    }

    /// What to report after a step, or nothing when the last report is fresh. The last step always reports.
    pub(super) fn report(
        &mut self,
        now_ms: i64,
        step: &StepReport,
        progress: Progress,
    ) -> Option<JobProgress> {
        if now_ms < self.reported_ms.saturating_add(INTERVAL_MS) && progress.step < progress.total {
            return None;
        }
        self.reported_ms = now_ms;
        Some(JobProgress {
            step: i64::from(progress.step),
            total: i64::from(progress.total),
            loss: Some(f64::from(step.loss)),
            psnr: Some(f64::from(step.psnr)),
            gaussians: i64::try_from(step.gaussians).ok(),
            eta_seconds: self.eta(now_ms, progress),
            message: Some("training".to_owned()),
        })
    }

    /// The mean pace of this attempt, carried to the end.
    fn eta(&self, now_ms: i64, progress: Progress) -> Option<f64> {
        let done = progress.step.saturating_sub(self.first_step);
        let seconds = (now_ms - self.started_ms) as f64 / 1e3;
        (done > 0)
            .then(|| seconds / f64::from(done) * f64::from(progress.total.saturating_sub(progress.step)))
    }
}

/// Reports what the worker does before the first step; the steps of earlier attempts stay.
pub(super) async fn announce(lease: &Lease, message: &str) -> Result<(), StoreError> {
    let job = lease.job();
    let update = JobProgress {
        step: job.checkpoint_step.unwrap_or(0),
        total: job.progress.total,
        message: Some(message.to_owned()),
        ..JobProgress::default()
    };
    lease.progress(&update).await.map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(step: u32) -> (StepReport, Progress) {
        let report = StepReport { step, loss: 0.5, psnr: 20.0, gaussians: 7, warning: None };
        (report, Progress { step, total: 100 })
    }

    #[test]
    fn events_are_throttled_but_the_last_step_is_always_told() {
        let mut reporter = Reporter::new(0, 0);
        let mut at = |ms, n| {
            let (report, progress) = step(n);
            reporter.report(ms, &report, progress).is_some()
        };
        assert_eq!(
            [at(0, 1), at(499, 2), at(500, 3), at(501, 99), at(502, 100)],
            [true, false, true, false, true]
        );
    }

    #[test]
    fn the_eta_counts_only_this_attempts_steps() {
        let mut reporter = Reporter::new(1000, 50);
        let (report, progress) = step(60);
        let update = reporter.report(3000, &report, progress).unwrap();
        assert_eq!(update.eta_seconds, Some(8.0));
    }
}
