//! What steps came to, as far as it is known: a device may be a step behind the schedule.

use crate::error::TrainError;
use crate::trainer::Trainer;
use crate::trainer::known_sums::{Asked, Known};
use relume_engine::StepSums;

impl Trainer {
    /// Notes that the engine was asked for the step at hand, and what it gave: the sums of this step or of an earlier one.
    pub(super) fn asked(&mut self, phase: u32, sums: Option<StepSums>) {
        self.sums.asked.push_back(Asked { step: self.schedule.step, phase });
        if let Some(sums) = sums {
            self.take(sums);
        }
    }

    /// Waits until every step is done, and takes in what they came to.
    pub(super) fn catch_up(&mut self) -> Result<(), TrainError> {
        while let Some(sums) = self.engine.finish()? {
            self.take(sums);
        }
        Ok(())
    }

    /// The same for whoever wants the state as it is: rolls back where a step was not finite, and has the next report say so.
    pub(super) fn catch_up_soundly(&mut self) -> Result<(), TrainError> {
        self.catch_up()?;
        if self.sums.unsound.is_some() {
            self.sums.warning = self.roll_back()?.warning;
        }
        Ok(())
    }

    /// The last step whose sums are known; waits for those of the first one.
    pub(super) fn known_sums(&mut self) -> Result<Known, TrainError> {
        if self.sums.latest.is_none() {
            self.catch_up()?;
        }
        Ok(self.sums.latest.unwrap_or(Known { step: self.schedule.step, loss: f32::MAX, psnr: 0.0 }))
    }

    fn take(&mut self, sums: StepSums) {
        let Some(asked) = self.sums.asked.pop_front() else { return };
        if !sums.finite {
            self.sums.unsound.get_or_insert(asked.step);
            return;
        }
        let psnr = -10.0 * sums.mse.max(1e-10).log10();
        self.schedule.complexity.record(asked.phase, psnr);
        self.sums.latest = Some(Known { step: asked.step + 1, loss: sums.loss, psnr });
    }
}
