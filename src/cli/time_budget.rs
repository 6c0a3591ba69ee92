//! `relume train --time`, `--until` and `--plan`: the clock of a time budget, and the settings planned for it.

use std::cell::Cell;
use std::path::Path;
use std::time::Instant;

use crate::cli::error::CommandResult;
use crate::cli::input;
use crate::cli::progress::ProgressReporter;
use crate::cli::train_summary::{MAX_VIEWS, TrainedCapture};
use relume_capture::{Capture, ImportLimits, Up};
use relume_engine::Device;
use relume_spec::training::{TrainConfig, TrainOverrides};
use relume_train::time_budget::{
    Eta, Pacing, PacingStart, PhotographCost, Planning, RecordedPlan, StepCost, import_planned,
    measurement_limit, reduced, scaled_cost, seconds, step_cost,
};
use relume_train::{MemoryBudget, Trainer};
use std::sync::Arc;

/// Ratios of the measured cost on the photographs to the expected one that do not change the plan.
const SAME_COST: std::ops::RangeInclusive<f64> = 0.85..=1.2;
/// Longest time to read the photographs, as a share of the budget, so that they may be read again at another size.
const READ_AGAIN_SHARE: f64 = 0.06;
/// Expected time to compare one photograph after the training, as a number of last steps, and that of a contact sheet.
const COMPARED_STEPS: f64 = 5.0;
const SHEET_STEPS: f64 = 25.0;

/// The seconds of a time budget that have passed, over all runs of a training.
#[derive(Debug)]
pub(super) struct BudgetClock {
    start: Instant,
    earlier: Cell<f64>,
}

impl BudgetClock {
    /// A clock that starts now.
    pub(super) fn start() -> Self {
        Self { start: Instant::now(), earlier: Cell::new(0.0) }
    }

    /// Adds the seconds of earlier runs.
    pub(super) fn add(&self, seconds: f64) {
        self.earlier.set(self.earlier.get() + seconds);
    }

    /// The estimate of the end of `trainer`, which trains on `capture`.
    pub(super) fn eta(&self, trainer: &Trainer, capture: &Capture) -> Eta {
        Eta::new(trainer.config(), PhotographCost::of(capture), trainer.progress().step, self.milliseconds())
    }

    fn milliseconds(&self) -> i64 {
        (1e3 * self.now()) as i64
    }

    /// Seconds that have passed.
    pub(super) fn now(&self) -> f64 {
        self.earlier.get() + self.start.elapsed().as_secs_f64()
    }
}

/// The work after the last step, as a number of last steps.
fn finish_steps(compared: usize, has_sheet: bool) -> f64 {
    COMPARED_STEPS * compared as f64 + if has_sheet { SHEET_STEPS } else { 0.0 }
}

/// The plan in a model file, or in its card as JSON.
pub(super) fn recorded_plan(file: &Path) -> CommandResult<RecordedPlan> {
    let named = |error: &dyn std::error::Error| format!("{}: {error}", file.display());
    let is_json = file.extension().is_some_and(|extension| extension == "json");
    let card = match is_json {
        true => {
            let text = std::fs::read(file).map_err(|error| named(&error))?;
            serde_json::from_slice(&text).map_err(|error| named(&error))?
        }
        false => input::read_model(file)?.card,
    };
    Ok(RecordedPlan::of_card(&card).map_err(|error| named(&error))?)
}

/// Measures the machine, plans the settings for the time budget of `overrides`, and reads the capture with them.
pub(super) fn planned_capture(
    (path, up): (&Path, Up),
    overrides: &TrainOverrides,
    device: &Device,
    memory: MemoryBudget,
    clock: &BudgetClock,
    has_sheet: bool,
) -> CommandResult<(Capture, TrainConfig, StepCost)> {
    let budget = overrides.time_budget_s.map_or(0.0, f64::from);
    let limit = measurement_limit(budget);
    let cost = step_cost(device, &|| clock.now(), limit)?;
    let (start, earlier) = (clock.start, clock.earlier.get());
    let now = move || earlier + start.elapsed().as_secs_f64();
    let finish_steps = finish_steps(MAX_VIEWS, has_sheet);
    let import = |cost| {
        let planning = Planning { overrides, cost, finish_steps, now: &now };
        import_planned(path, up, &ImportLimits::default(), memory, &planning)
    };
    let begun = clock.now();
    let (capture, config) = import(cost)?;
    let reading = clock.now() - begun;
    let scaled = scaled_cost(&capture, &config, cost, device, &|| clock.now(), 2.0 * limit)?;
    let sizes: Vec<_> = capture.train.iter().map(|v| (v.image.width, v.image.height)).collect();
    let photographs = reduced(&sizes, config.resolution);
    let expected = |cost| seconds(&config, photographs, cost, finish_steps);
    let ratio = expected(scaled) / expected(cost);
    if SAME_COST.contains(&ratio) || reading > READ_AGAIN_SHARE * budget {
        return Ok((capture, config, scaled));
    }
    drop(capture);
    let (capture, config) = import(scaled)?;
    Ok((capture, config, scaled))
}

/// Follows the plan of one training.
pub(super) struct Pace<'a> {
    pacing: Option<Pacing>,
    eta: Eta,
    clock: &'a BudgetClock,
    device: &'a Device,
    has_sheet: bool,
}

impl<'a> Pace<'a> {
    /// A training without a plan, or one that repeats a recorded plan.
    pub(super) fn none(clock: &'a BudgetClock, device: &'a Device, eta: Eta) -> Self {
        Self { pacing: None, eta, clock, device, has_sheet: false }
    }

    /// The plan of `trainer`, if it has a time budget or a stop condition. The time of earlier runs is added to the clock.
    pub(super) fn of(
        trainer: &mut Trainer,
        capture: &Capture,
        (clock, device): (&'a BudgetClock, &'a Device),
        cost: Option<StepCost>,
        compared: usize,
        has_sheet: bool,
    ) -> CommandResult<Self> {
        clock.add(trainer.budget().map_or(0.0, |budget| budget.used));
        let start = PacingStart { now: clock.now(), cost, finish_steps: finish_steps(compared, has_sheet) };
        let pacing = Pacing::new(trainer, capture, &start)?;
        let eta = clock.eta(trainer, capture);
        Ok(Self { pacing, eta, clock, device, has_sheet })
    }

    /// Reports the plan at the start.
    pub(super) fn announce(&self, trainer: &Trainer, progress: &ProgressReporter) {
        if let Some(pacing) = &self.pacing {
            progress.status(&pacing.announcement(trainer, self.clock.now()));
        }
    }

    /// Follows one step, and reports changes of the plan.
    pub(super) fn after_step(
        &mut self,
        trainer: &mut Trainer,
        summary: &mut TrainedCapture,
        progress: &ProgressReporter,
    ) -> CommandResult {
        self.eta.note(trainer.progress().step, self.clock.milliseconds());
        let Some(pacing) = &mut self.pacing else { return Ok(()) };
        let now = || self.clock.now();
        if let Some(told) = pacing.after_step(trainer, self.device, &now)? {
            progress.status(&told);
        }
        if pacing.wants_finish(trainer) {
            let model = Arc::new(trainer.model()?);
            let seconds = summary.rehearse(&model, self.device, self.has_sheet, &now);
            pacing.set_finish(seconds, now());
        }
        Ok(())
    }

    /// Expected seconds to the end: by the plan of a time budget, otherwise by the pace of recent steps.
    pub(super) fn seconds_left(&self, trainer: &Trainer) -> Option<f64> {
        let planned = self.pacing.as_ref().and_then(|pacing| pacing.seconds_left(trainer, self.clock.now()));
        planned.or_else(|| self.eta.seconds())
    }
}
