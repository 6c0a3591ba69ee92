//! What steps came to, as far as it is known: a device may be a step behind the schedule.

use std::collections::VecDeque;

use crate::engine::StepSums;
use crate::train::error::TrainError;
use crate::train::trainer::Trainer;

/// A step that the engine was asked for.
struct Asked {
    step: u32,
    /// Which of the records its PSNR belongs to.
    phase: u32,
}

/// What is known of the steps so far.
#[derive(Default)]
pub(super) struct KnownSums {
    /// Steps whose sums are not known, oldest first.
    asked: VecDeque<Asked>,
    /// Objective and PSNR of the last step whose sums are known.
    latest: Option<(f32, f32)>,
    /// A step that was not finite: what was done since must not be built on.
    pub(super) unsound: Option<u32>,
}

impl KnownSums {
    /// Forgets the steps that are rolled back; gives the one that was not finite.
    pub(super) fn roll_back(&mut self) -> Option<u32> {
        self.asked.clear();
        self.unsound.take()
    }
}

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

    /// Objective and PSNR of the last step whose sums are known; waits for those of the first one.
    pub(super) fn known_sums(&mut self) -> Result<(f32, f32), TrainError> {
        if self.sums.latest.is_none() {
            self.catch_up()?;
        }
        Ok(self.sums.latest.unwrap_or((f32::MAX, 0.0)))
    }

    fn take(&mut self, sums: StepSums) {
        let Some(asked) = self.sums.asked.pop_front() else { return };
        if !sums.finite {
            self.sums.unsound.get_or_insert(asked.step);
            return;
        }
        let psnr = -10.0 * sums.mse.max(1e-10).log10();
        self.schedule.complexity.record(asked.phase, psnr);
        self.sums.latest = Some((sums.loss, psnr));
    }
}
