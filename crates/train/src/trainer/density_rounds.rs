//! The rounds of density control during a training.

use crate::TrainError;
use crate::density;
use crate::trainer::Trainer;
use relume_engine::PhotoSize;

/// Largest number of steps between two rounds.
const REFINE_EVERY: u32 = 100;

impl Trainer {
    /// Adds and drops Gaussians if a round is due after this step.
    pub(super) fn refine(&mut self) -> Result<(), TrainError> {
        let (step, total) = (self.schedule.step, self.config.iterations);
        let last = (self.config.densify_until * total as f32) as u32;
        let first = (total / 50).max(50);
        let every = REFINE_EVERY.min((total / 15).max(10));
        let mut reached = self.schedule.timeline.covered(step);
        let is_round = |p: &u32| (first..=last).contains(p) && p.is_multiple_of(every);
        let Some(position) = reached.find(is_round) else { return Ok(()) };
        self.wait_for_steps()?;
        if self.tracker.non_finite_step.is_some() {
            return Ok(());
        }
        // The budget grows with the square root of progress, so that early Gaussians converge first.
        let share = ((position - first) as f32 / (last - first).max(1) as f32).sqrt();
        let max = self.schedule.timeline.max_gaussians(step).unwrap_or(self.config.max_gaussians);
        let max = max.min(self.config.max_gaussians);
        let (low, high) = (self.config.initial_gaussians.min(max) as f32, max as f32);
        self.schedule.complexity.before_round(&self.config, step, self.engine.gaussians());
        let most = self.schedule.complexity.most_gaussians.unwrap_or(u32::MAX) as usize;
        let budget = ((low + (high - low) * share) as usize).min(most);
        let centres = (!self.data.has_alpha).then(|| self.data.camera_centres());
        let _span = tracing::info_span!("density", budget).entered();
        let signals = self.engine.density_signals()?;
        self.engine.rebuild(&density::plan(&signals, budget, centres.as_deref()))?;
        if is_clearing_round(position, first, last, every) {
            self.drop_unseen()?;
        }
        if position > self.config.warm_up_steps() && self.measures() {
            // New Gaussians need their own labels and gathered light.
            self.measure(1)?;
        }
        Ok(())
    }

    /// Drops the Gaussians that no photograph shows.
    pub(super) fn drop_unseen(&mut self) -> Result<(), TrainError> {
        let state = self.engine.state()?;
        if state.model.check().is_err() {
            // The next step rolls back, and the schedule reaches this point again.
            return Ok(());
        }
        let plan = density::without_unseen(&state, &self.data.cameras(PhotoSize::Half));
        Ok(plan.map_or(Ok(()), |plan| self.engine.rebuild(&plan))?)
    }
}

/// True for two of the density control rounds, which are `every` steps apart: half-way between `first` and `last`, and the last one.
/// They also drop the Gaussians that no photograph shows, because the following rounds and steps then fill the gaps.
fn is_clearing_round(position: u32, first: u32, last: u32, every: u32) -> bool {
    let contains = |due: u32| position <= due && due - position < every;
    contains(last) || contains(first + last.saturating_sub(first) / 2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_rounds_also_drop_gaussians_without_a_photograph() {
        for (first, last, every) in [(50u32, 900, 100u32), (50, 450, 50), (140, 4200, 100)] {
            let rounds = (first..=last).filter(|position| position.is_multiple_of(every));
            let clearing: Vec<u32> =
                rounds.filter(|position| is_clearing_round(*position, first, last, every)).collect();
            assert_eq!(clearing.len(), 2, "{clearing:?}");
            assert!(last - clearing[1] < every && clearing[0] > first, "{clearing:?}");
        }
        assert!(!is_clearing_round(100, 50, 900, 100), "the control: an early round");
    }
}
