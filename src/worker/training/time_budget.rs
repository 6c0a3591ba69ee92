//! The time budget and the stop condition of a job: the clock of its attempts, and the settings planned for it.

use std::sync::Arc;

use crate::worker::job_source::JobSource;
use crate::worker::thread::Worker;
use crate::worker::training::comparison::MAX_VIEWS;
use crate::worker::training::outcome::AttemptError;
use crate::worker::training::preparation::Checkpoint;
use relume_capture::Capture;
use relume_engine::Device;
use relume_spec::training::TrainConfig;
use relume_train::time_budget::{Pacing, PacingStart, StepCost, measurement_limit, step_cost};
use relume_train::{TrainError, Trainer, planned_config};

/// Expected time to compare one held-out view, and to publish the model, as numbers of last steps.
const COMPARED_STEPS: f64 = 2.0;
const PUBLISHED_STEPS: f64 = 5.0;

/// Seconds since the start of an attempt.
#[derive(Clone)]
pub(super) struct AttemptClock {
    source: Arc<dyn JobSource>,
    start_ms: i64,
}

impl AttemptClock {
    /// A clock that starts now.
    pub(super) fn start(source: &Arc<dyn JobSource>) -> Self {
        Self { source: source.clone(), start_ms: source.now_ms() }
    }

    /// Milliseconds since the start of the attempt.
    pub(super) fn ms(&self) -> i64 {
        (self.source.now_ms() - self.start_ms).max(0)
    }

    /// Seconds since the start of the attempt.
    pub(super) fn seconds(&self) -> f64 {
        self.ms() as f64 / 1e3
    }
}

/// The work after the last step, as a number of last steps.
pub(super) fn finish_steps() -> f64 {
    COMPARED_STEPS * MAX_VIEWS as f64 + PUBLISHED_STEPS
}

/// The settings with which the last checkpoint was written, if the job has a time budget and the checkpoint is readable.
pub(super) fn planned_before(checkpoint: &Checkpoint, config: &TrainConfig) -> Option<TrainConfig> {
    let bytes = checkpoint.as_ref()?.as_ref().ok()?;
    config.time_budget_s?;
    planned_config(bytes, config).ok()
}

impl Worker {
    /// Measures a step on the device of a job with a time budget, seconds.
    pub(super) fn step_cost(
        device: &Device,
        config: &TrainConfig,
        clock: &AttemptClock,
    ) -> Result<StepCost, AttemptError> {
        let budget = config.time_budget_s.map_or(0.0, f64::from);
        let limit = measurement_limit(budget);
        Ok(step_cost(device, &|| clock.seconds(), limit)?)
    }
}

/// The pacing of one attempt.
pub(super) struct AttemptPacing {
    pacing: Pacing,
    clock: AttemptClock,
    /// Seconds of the budget that earlier attempts have used.
    earlier: f64,
}

impl AttemptPacing {
    /// The pacing of `trainer`; `None` for a job without a time budget and a stop condition.
    pub(super) fn new(
        trainer: &mut Trainer,
        capture: &Capture,
        clock: AttemptClock,
        cost: Option<StepCost>,
    ) -> Result<Option<Self>, TrainError> {
        let earlier = trainer.budget().map_or(0.0, |budget| budget.used);
        let now = earlier + clock.seconds();
        let start = PacingStart { now, cost, finish_steps: finish_steps() };
        Ok(Pacing::new(trainer, capture, &start)?.map(|pacing| Self { pacing, clock, earlier }))
    }

    /// The plan in words.
    pub(super) fn announcement(&self, trainer: &Trainer) -> String {
        self.pacing.announcement(trainer, self.now())
    }

    /// Follows one step. Returns the plan in words if it changed, and the seconds to the end.
    pub(super) fn after_step(
        &mut self,
        trainer: &mut Trainer,
        device: &Device,
    ) -> Result<(Option<String>, Option<f64>), TrainError> {
        let (clock, earlier) = (&self.clock, self.earlier);
        let told = self.pacing.after_step(trainer, device, &|| earlier + clock.seconds())?;
        Ok((told, self.pacing.seconds_left(trainer, self.now())))
    }

    fn now(&self) -> f64 {
        self.earlier + self.clock.seconds()
    }
}
