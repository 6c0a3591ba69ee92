//! The plan of a training whose number of steps changes on the way, and the timed probes on which it is based.

use crate::time_budget::{BudgetState, PlanChange, ProbeCost, Timeline};
use crate::trainer::Trainer;
use crate::{TrainError, schedule};
use relume_engine::{evaluation, fibonacci_sphere};
use relume_scene::SplitLight;

/// Number of directions in which the probes of the host are timed.
const HOST_DIRECTIONS: usize = 32;

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

    /// Times the probes of one measurement of the visibility on the device and those of a few directions on the host. `now`
    /// returns the time, seconds. `None` if the training measures no visibility.
    pub(crate) fn probe_cost(&mut self, now: &dyn Fn() -> f64) -> Result<Option<ProbeCost>, TrainError> {
        if !schedule::measures(&self.config) {
            return Ok(None);
        }
        self.wait_for_finite_state()?;
        let start = now();
        self.measure(1)?;
        let device = now() - start;
        let state = self.engine.state()?;
        let lights = fibonacci_sphere(HOST_DIRECTIONS);
        let lights: Vec<_> =
            lights.into_iter().map(|direction| SplitLight { direction, radius: 0.0 }).collect();
        let start = now();
        let members: Vec<u32> = (0..state.model.gaussians.len()).map(|i| i as u32).collect();
        evaluation::light_shares(&state, &lights, &members);
        let host = now() - start;
        let per_probe = |seconds: f64, directions: usize| {
            seconds / (directions.max(1) * state.model.gaussians.len().max(1)) as f64
        };
        let directions = self.config.probe_directions as usize;
        Ok(Some(ProbeCost { device: per_probe(device, directions), host: per_probe(host, HOST_DIRECTIONS) }))
    }
}
