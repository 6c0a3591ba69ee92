//! What steps came to, as far as it is known: a device may be a step behind the schedule.

use crate::error::TrainError;
use crate::trainer::Trainer;
use crate::trainer::step_tracker::{PendingStep, StepMetrics};
use relume_engine::StepResult;

impl Trainer {
    /// Notes that the engine was asked for the step at hand, and what it gave: the sums of this step or of an earlier one.
    pub(super) fn record_step(&mut self, phase: u32, sums: Option<StepResult>) {
        self.tracker.pending.push_back(PendingStep { step: self.schedule.step, phase });
        if let Some(sums) = sums {
            self.take(sums);
        }
    }

    /// Waits until every step is done, and takes in what they came to.
    pub(super) fn wait_for_steps(&mut self) -> Result<(), TrainError> {
        while let Some(sums) = self.engine.finish()? {
            self.take(sums);
        }
        Ok(())
    }

    /// The same for whoever wants the state as it is: rolls back where a step was not finite, and has the next report say so.
    pub(super) fn wait_for_finite_state(&mut self) -> Result<(), TrainError> {
        self.wait_for_steps()?;
        if self.tracker.non_finite_step.is_some() {
            self.tracker.warning = self.roll_back()?.warning;
        }
        Ok(())
    }

    /// The last step whose sums are known; waits for those of the first one.
    pub(super) fn latest_metrics(&mut self) -> Result<StepMetrics, TrainError> {
        if self.tracker.latest.is_none() {
            self.wait_for_steps()?;
        }
        Ok(self.tracker.latest.unwrap_or(StepMetrics { step: self.schedule.step, loss: f32::MAX, psnr: 0.0 }))
    }

    fn take(&mut self, sums: StepResult) {
        let Some(asked) = self.tracker.pending.pop_front() else { return };
        if !sums.finite {
            self.tracker.non_finite_step.get_or_insert(asked.step);
            return;
        }
        let psnr = -10.0 * sums.mse.max(1e-10).log10();
        self.schedule.complexity.record(asked.phase, psnr);
        self.tracker.latest = Some(StepMetrics { step: asked.step + 1, loss: sums.loss, psnr });
    }
}
