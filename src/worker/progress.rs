//! Turns step reports into progress events: at most two per second, each with the expected time to the end.

use crate::worker::job_source::{Claim, JobSourceError};
use relume_api::jobs::JobProgress;
use relume_train::time_budget::Eta;
use relume_train::{Progress, StepReport};

/// Minimum time between two progress events, milliseconds.
const INTERVAL_MS: i64 = 500;

/// Decides when progress is reported.
pub(super) struct ProgressReporter {
    eta: Eta,
    reported_ms: i64,
    last: JobProgress,
    /// The plan of a training with a time budget or a stop condition, in words.
    plan: Option<String>,
    /// Seconds to the end by that plan; they replace the estimate.
    seconds_left: Option<f64>,
}

impl ProgressReporter {
    pub(super) fn new(eta: Eta) -> Self {
        let (plan, seconds_left) = (None, None);
        Self { eta, reported_ms: i64::MIN, last: JobProgress::default(), plan, seconds_left }
    }

    /// Records the plan of a training with a time budget or a stop condition: `told` if its words changed.
    pub(super) fn plan(&mut self, told: Option<String>, seconds_left: Option<f64>) {
        self.plan = told.or(self.plan.take());
        self.seconds_left = seconds_left;
    }

    /// The report of a step that ended at `now_ms`; `None` if the last report is recent. The last step is always reported.
    pub(super) fn report(
        &mut self,
        now_ms: i64,
        step: &StepReport,
        progress: Progress,
    ) -> Option<JobProgress> {
        self.eta.note(progress.step, now_ms);
        // A clock that was set back does not delay the next report.
        let is_recent = (self.reported_ms..self.reported_ms.saturating_add(INTERVAL_MS)).contains(&now_ms);
        if is_recent && progress.step < progress.total {
            return None;
        }
        self.reported_ms = now_ms;
        self.last = JobProgress {
            step: i64::from(progress.step),
            total: i64::from(progress.total),
            loss: Some(f64::from(step.loss)),
            psnr: Some(f64::from(step.psnr)),
            gaussians: i64::try_from(step.gaussians).ok(),
            eta_seconds: self.seconds_left.or_else(|| self.eta.seconds()),
            message: Some(self.plan.clone().unwrap_or_else(|| "training".to_owned())),
        };
        Some(self.last.clone())
    }

    /// The report of work after the last step, with the figures of that step.
    pub(super) fn after_training(&self, progress: Progress, message: String) -> JobProgress {
        JobProgress {
            step: i64::from(progress.step),
            total: i64::from(progress.total),
            eta_seconds: None,
            message: Some(message),
            ..self.last.clone()
        }
    }
}

/// Reports the worker's activity before the first step, with the step of earlier attempts.
pub(super) async fn announce(claim: &dyn Claim, message: &str) -> Result<(), JobSourceError> {
    let task = claim.task();
    let update = JobProgress {
        step: task.checkpoint_step.unwrap_or(0),
        total: task.total,
        message: Some(message.to_owned()),
        ..JobProgress::default()
    };
    claim.progress(&update).await.map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_spec::training::{Preset, TrainConfig};
    use relume_train::time_budget::PhotographCost;

    fn step(step: u32) -> (StepReport, Progress) {
        let report =
            StepReport { step, metrics_step: step, loss: 0.5, psnr: 20.0, gaussians: 7, warning: None };
        (report, Progress { step, total: 100 })
    }

    #[test]
    fn events_of_a_planned_training_tell_the_plan() {
        let config = TrainConfig { iterations: 100, ..TrainConfig::preset(Preset::Draft) };
        let mut reporter =
            ProgressReporter::new(Eta::new(&config, PhotographCost { count: 1.0, pixels: 1.0 }, 0, 0));
        let mut at = |ms, n, told: Option<&str>, left| {
            reporter.plan(told.map(str::to_owned), left);
            let (report, progress) = step(n);
            let event = reporter.report(ms, &report, progress).unwrap();
            (event.message.unwrap(), event.eta_seconds)
        };
        assert_eq!(at(0, 1, None, None).0, "training", "the control");
        assert_eq!(
            at(1000, 2, Some("planned: 100 steps"), Some(9.0)),
            ("planned: 100 steps".into(), Some(9.0))
        );
        assert_eq!(at(2000, 3, None, Some(8.0)), ("planned: 100 steps".into(), Some(8.0)));
    }

    #[test]
    fn events_are_throttled_but_the_last_step_is_always_sent() {
        let config = TrainConfig { iterations: 100, ..TrainConfig::preset(Preset::Draft) };
        let mut reporter =
            ProgressReporter::new(Eta::new(&config, PhotographCost { count: 1.0, pixels: 1.0 }, 0, 0));
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
    fn events_continue_when_the_clock_is_set_back() {
        let config = TrainConfig { iterations: 100, ..TrainConfig::preset(Preset::Draft) };
        let photographs = PhotographCost { count: 1.0, pixels: 1.0 };
        let mut reporter = ProgressReporter::new(Eta::new(&config, photographs, 0, 1_000_000));
        let mut at = |ms, n| {
            let (report, progress) = step(n);
            reporter.report(ms, &report, progress).is_some()
        };
        assert_eq!(
            [at(1_000_000, 1), at(10_000, 2), at(10_400, 3), at(10_500, 4)],
            [true, true, false, true]
        );
    }
}
