//! Processes the results of steps. A device may be one step behind the schedule.

use crate::error::TrainError;
use crate::trainer::Trainer;
use crate::trainer::step_tracker::{PendingStep, StepMetrics};
use relume_engine::StepResult;

impl Trainer {
    /// Records that the engine was given the current step, and the result that it returned, of this step or an
    /// earlier one.
    pub(super) fn record_step(&mut self, phase: u32, sums: Option<StepResult>) {
        self.tracker.pending.push_back(PendingStep { step: self.schedule.step, phase });
        if let Some(sums) = sums {
            self.take(sums);
        }
    }

    /// Waits until all steps are completed, and records their results.
    pub(super) fn wait_for_steps(&mut self) -> Result<(), TrainError> {
        while let Some(sums) = self.engine.finish()? {
            self.take(sums);
        }
        Ok(())
    }

    /// As [`Self::wait_for_steps`], for a caller that needs the state: rolls back after a non-finite step, with a
    /// warning in the next report.
    pub(super) fn wait_for_finite_state(&mut self) -> Result<(), TrainError> {
        self.wait_for_steps()?;
        if self.tracker.non_finite_step.is_some() {
            self.tracker.warning = self.roll_back()?.warning;
        }
        Ok(())
    }

    /// Metrics of the last step whose result is known; waits for the first result.
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
