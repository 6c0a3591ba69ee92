//! Follows a training with a time budget or a stop condition, and changes its plan.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::TrainError;
use crate::eval::{EvalError, NovelViews, evenly_spaced};
use crate::render::RenderError;
use crate::time_budget::cost::{ScheduleCost, StepCost};
use crate::time_budget::pacer::{Pacer, WHY_TIME};
use crate::time_budget::plan::{announcement, reduced};
use crate::time_budget::timeline::PlanChange;
use crate::time_budget::watch::{self, LAST_TENTH, Watch};
use crate::trainer::Trainer;
use relume_capture::{Capture, CaptureView};
use relume_engine::Device;
use relume_spec::rendering::Tier;
use relume_spec::training::UntilFigure;

/// Most held-out photographs on which a stop condition is measured. A check takes about as long as ten steps.
const CHECKED_VIEWS: usize = 4;
/// Share of the schedule after which the work after the last step is measured: almost all Gaussians exist.
const FINISH_FROM: f64 = 0.55;
/// Change of the number of steps that is announced.
const ANNOUNCED_CHANGE: f64 = 0.05;

/// The part of a time budget that a checkpoint keeps.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BudgetState {
    /// Seconds of the budget that have passed.
    pub used: f64,
    /// Measured cost of a step, seconds.
    pub cost: StepCost,
}

/// Inputs of a [`Pacing`] at the start of the steps.
#[derive(Debug, Clone, Copy)]
pub struct PacingStart {
    /// Seconds of the budget that have passed, over all runs.
    pub now: f64,
    /// Measured cost of a step, seconds. `None`: the cost in the checkpoint is used; without one, the pacing uses only the ratios
    /// between the kinds of work.
    pub cost: Option<StepCost>,
    /// Expected time of the work after the last step, as a number of last steps.
    pub finish_steps: f64,
}

/// Plans and stops one training. Its caller passes the time after each step.
pub struct Pacing {
    pacer: Option<Pacer>,
    watch: Option<Watch>,
    /// Held-out photographs for the stop condition.
    views: Vec<CaptureView>,
    /// Number of steps that was announced last.
    announced: u32,
    has_finish: bool,
}

impl Pacing {
    /// The pacing of `trainer`, which trains on `capture`; `None` without a time budget and a stop condition.
    ///
    /// # Errors
    /// [`TrainError::Invalid`] for a stop condition without held-out photographs.
    pub fn new(
        trainer: &mut Trainer,
        capture: &Capture,
        start: &PacingStart,
    ) -> Result<Option<Self>, TrainError> {
        let config = trainer.config();
        let (position, step) = (trainer.position(), trainer.progress().step);
        let views = match config.until {
            Some(_) if capture.test.is_empty() => {
                let reason = "until: the capture has no held-out photographs on which it could be measured";
                return Err(TrainError::Invalid(reason.to_owned()));
            }
            Some(_) => checked_views(capture, config.light_rotations),
            None => Vec::new(),
        };
        let watch = config.until.map(|until| Watch::new(until, config, position));
        let cost = start.cost.or(trainer.budget().map(|budget| budget.cost)).unwrap_or(StepCost::RELATIVE);
        let mut pacer = config.time_budget_s.map(|budget| {
            let sizes: Vec<_> = capture.train.iter().map(|v| (v.image.width, v.image.height)).collect();
            let cost = ScheduleCost::new(config, reduced(&sizes, config.resolution), cost);
            Pacer::new(f64::from(budget), cost, start.now, step, start.finish_steps)
        });
        // A resumed training that has met its stop condition completes its schedule.
        let is_completing = trainer.timeline().changes().iter().any(|change| change.why != WHY_TIME);
        if let Some(pacer) = pacer.as_mut().filter(|_| is_completing) {
            pacer.only_shorten();
        }
        if pacer.is_none() && watch.is_none() {
            return Ok(None);
        }
        if pacer.is_some() {
            trainer.set_budget(BudgetState { used: start.now, cost });
        }
        let announced = trainer.progress().total;
        Ok(Some(Self { pacer, watch, views, announced, has_finish: false }))
    }

    /// The current plan in words; `now` as in [`Self::after_step`].
    pub fn announcement(&self, trainer: &Trainer, now: f64) -> String {
        announcement(trainer.config(), trainer.progress().total, self.seconds_left(trainer, now))
    }

    /// Expected seconds to the end of the training and of the work after it; `None` without a time budget.
    pub fn seconds_left(&self, trainer: &Trainer, now: f64) -> Option<f64> {
        let pacer = self.pacer.as_ref()?;
        let budget = trainer.config().time_budget_s.map(f64::from);
        let end = pacer.end(trainer.timeline()).or(budget)?;
        Some((end - now).max(0.0))
    }

    /// Whether the caller should now measure the work after the last step, and call [`Self::set_finish`].
    pub fn wants_finish(&self, trainer: &Trainer) -> bool {
        let positions = f64::from(trainer.timeline().positions());
        let is_late = f64::from(trainer.position()) >= FINISH_FROM * positions;
        self.pacer.is_some() && !self.has_finish && is_late && !trainer.is_done()
    }

    /// Sets the time that the work after the last step takes, seconds; `now` after the measurement.
    pub fn set_finish(&mut self, seconds: Option<f64>, now: f64) {
        self.has_finish = true;
        if let Some(pacer) = &mut self.pacer {
            pacer.skip_to(now);
            if let Some(seconds) = seconds {
                pacer.set_finish(seconds);
            }
        }
    }

    /// Follows one step of `trainer`. `now` returns the seconds of the budget that have passed, over all runs. Returns
    /// what the user should know about the plan.
    ///
    /// # Errors
    /// As [`Trainer::model`], and if a held-out photograph cannot be compared.
    pub fn after_step(
        &mut self,
        trainer: &mut Trainer,
        device: &Device,
        now: &dyn Fn() -> f64,
    ) -> Result<Option<String>, TrainError> {
        let is_due = self.watch.as_ref().is_some_and(|watch| watch.is_due(trainer.position()));
        let checks = is_due && !trainer.is_done();
        if let Some(pacer) = &mut self.pacer {
            pacer.note(trainer.timeline(), trainer.progress().step, now());
            // The plan changes at most once after a step, and the stop condition has priority.
            let change = if checks { None } else { pacer.plan(trainer.timeline()) };
            if let Some(change) = change {
                trainer.replan(change)?;
            }
        }
        let mut told = if checks { self.check(trainer, device, now)? } else { None };
        if let Some(budget) = trainer.budget() {
            trainer.set_budget(BudgetState { used: now(), ..budget });
        }
        let total = trainer.progress().total;
        let change = f64::from(total) / f64::from(self.announced.max(1)) - 1.0;
        if told.is_none() && self.pacer.is_some() && change.abs() >= ANNOUNCED_CHANGE {
            told = Some(self.announcement(trainer, now()));
        }
        if told.is_some() {
            self.announced = total;
        }
        Ok(told)
    }

    /// Measures the figure of the stop condition, and completes the schedule if the training may stop.
    fn check(
        &mut self,
        trainer: &mut Trainer,
        device: &Device,
        now: &dyn Fn() -> f64,
    ) -> Result<Option<String>, TrainError> {
        let Some(watch) = &mut self.watch else { return Ok(None) };
        let start = now();
        let value = measured(&self.views, watch.until().figure, trainer, device)?;
        if !trainer.timeline().may_change(trainer.progress().step) {
            // The training was rolled back to a step before the last change; a later check follows.
            return Ok(None);
        }
        // After a roll-back the position is another one.
        let position = trainer.position();
        let stop = watch.note(position, value);
        if let Some(pacer) = &mut self.pacer {
            pacer.skip_to(now());
            pacer.set_reserve((now() - start) * f64::from(watch.left(position)));
        }
        let Some(stop) = stop else { return Ok(None) };
        let why = watch::reason(watch.until(), stop);
        self.complete(trainer, why).map(Some)
    }

    /// Jumps to the last tenth of the schedule.
    fn complete(&mut self, trainer: &mut Trainer, why: String) -> Result<String, TrainError> {
        let (progress, timeline) = (trainer.progress(), trainer.timeline());
        let change =
            last_tenth(progress.step, progress.total, trainer.position(), timeline.positions(), &why);
        let total = change.total;
        trainer.replan(change)?;
        self.watch = None;
        if let Some(pacer) = &mut self.pacer {
            pacer.only_shorten();
            pacer.set_reserve(0.0);
        }
        Ok(format!("{why}: stops after {} more steps with falling step sizes", total - progress.step))
    }
}

/// The plan that completes the last tenth of the schedule, at the current number of steps per position.
fn last_tenth(step: u32, total: u32, position: u32, positions: u32, why: &str) -> PlanChange {
    let stretch = f64::from(total - step) / f64::from(positions - position).max(1.0);
    let from = position.max((f64::from(positions) * (1.0 - LAST_TENTH)) as u32);
    let steps = (f64::from(positions - from) * stretch).round().max(1.0) as u32;
    PlanChange { step, position: from, total: step + steps, why: why.to_owned() }
}

/// The held-out photographs on which a stop condition is measured. Their pixels are shared with `capture`.
fn checked_views(capture: &Capture, with_rotations: bool) -> Vec<CaptureView> {
    let as_trained = |view: &CaptureView| CaptureView {
        light_rotation_deg: if with_rotations { view.light_rotation_deg } else { 0.0 },
        ..view.clone()
    };
    evenly_spaced(&capture.test, Some(CHECKED_VIEWS)).into_iter().map(as_trained).collect()
}

/// The figure on `views`; `None` if the model has no such figure, or if a view could not be compared: a later check follows.
fn measured(
    views: &[CaptureView],
    figure: UntilFigure,
    trainer: &mut Trainer,
    device: &Device,
) -> Result<Option<f64>, TrainError> {
    let model = Arc::new(trainer.model()?);
    let compared = NovelViews::new(model, Tier::Standard.into(), device).and_then(|mut compared| {
        views.iter().try_for_each(|view| compared.compare(view))?;
        Ok(compared.scores().shaded)
    });
    match (compared, figure) {
        (Ok(scores), UntilFigure::NovelViewPsnr) => Ok(scores.psnr),
        (Ok(scores), UntilFigure::NovelViewSsim) => Ok(scores.ssim),
        (Err(EvalError::Device(error) | EvalError::Render { source: RenderError::Device(error), .. }), _) => {
            Err(TrainError::Device(error))
        }
        (Err(error), _) => {
            tracing::warn!(%error, "until: a held-out photograph could not be compared");
            Ok(None)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_tenth_keeps_the_steps_per_position() {
        let change = last_tenth(600, 2_400, 600, 1_500, "plateau");
        assert_eq!((change.position, change.total), (1_350, 600 + 300));
        let late = last_tenth(1_400, 1_500, 1_400, 1_500, "plateau");
        assert_eq!((late.position, late.total), (1_400, 1_500), "nothing is left out");
        let tiny = last_tenth(3, 4, 3, 4, "plateau");
        assert_eq!((tiny.position, tiny.total), (3, 4));
    }
}
