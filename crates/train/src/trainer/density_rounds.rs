//! The rounds of density control during a training.

use crate::TrainError;
use crate::density;
use crate::schedule;
use crate::trainer::Trainer;
use crate::unseen;
use relume_engine::PhotoSize;

impl Trainer {
    /// Adds and drops Gaussians if a round is due after this step.
    pub(super) fn refine(&mut self) -> Result<(), TrainError> {
        let step = self.schedule.step;
        let rounds = schedule::density_rounds(&self.config);
        let mut reached = self.schedule.timeline.reached(step);
        let Some(position) = reached.rfind(|p| rounds.contains(*p)) else { return Ok(()) };
        self.wait_for_steps()?;
        if self.tracker.non_finite_step.is_some() {
            return Ok(());
        }
        // The budget grows with the square root of progress, so that early Gaussians converge first.
        let share = ((position - rounds.first) as f32 / (rounds.last - rounds.first).max(1) as f32).sqrt();
        let (low, high) = (self.config.initial_gaussians as f32, self.config.max_gaussians as f32);
        self.schedule.complexity.before_round(&self.config, step, self.engine.gaussians());
        let most = self.schedule.complexity.most_gaussians.unwrap_or(u32::MAX) as usize;
        let budget = ((low + (high - low) * share) as usize).min(most);
        let centres = (!self.data.has_alpha).then(|| self.data.camera_centres());
        let _span = tracing::info_span!("density", budget).entered();
        let signals = self.engine.density_signals()?;
        self.engine.rebuild(&density::plan(&signals, budget, centres.as_deref()))?;
        Ok(())
    }

    /// Hides the Gaussians that no photograph shows. The remaining steps close the gaps in the surfaces before them.
    pub(super) fn hide_unseen(&mut self) -> Result<(), TrainError> {
        let mut state = self.engine.state()?.into_owned();
        if state.model.check().is_err() {
            // The next step rolls back, and the schedule reaches this point again.
            return Ok(());
        }
        let _span = tracing::info_span!("hide_unseen").entered();
        unseen::hide(&mut state, &self.data.cameras(PhotoSize::Half));
        Ok(self.engine.load(state)?)
    }
}
