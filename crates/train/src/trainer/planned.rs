//! The plan of a training whose number of steps changes on the way.

use crate::TrainError;
use crate::time_budget::{BudgetState, PlanChange, Timeline};
use crate::trainer::Trainer;

impl Trainer {
    /// Position of each step in the schedule.
    pub fn timeline(&self) -> &Timeline {
        &self.schedule.timeline
    }

    /// Position in the schedule, 0 to the number of iterations of the configuration. Without a change of the plan it is
    /// the number of completed steps.
    pub fn position(&self) -> u32 {
        self.schedule.position()
    }

    /// Changes the number of steps from the current step on.
    ///
    /// # Errors
    /// [`TrainError::Invalid`] if the change does not begin at the current step, or does not follow the plan so far.
    pub fn replan(&mut self, change: PlanChange) -> Result<(), TrainError> {
        if change.step != self.schedule.step {
            let at = self.schedule.step;
            return Err(TrainError::Invalid(format!("time_plan.step: must be the current step {at}")));
        }
        self.schedule.timeline.change(change)
    }

    /// The time budget so far, if the training has one.
    pub fn budget(&self) -> Option<BudgetState> {
        self.schedule.budget
    }

    /// Sets the time budget so far; checkpoints keep it.
    pub fn set_budget(&mut self, budget: BudgetState) {
        self.schedule.budget = Some(budget);
    }
}
