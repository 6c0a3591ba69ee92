//! Plans the remaining steps of a training again, so that it ends at the end of its time budget.
//!
//! The time of steps, measurements, restarts and comparisons is measured separately, each relative to its cost
//! ([`ScheduleCost`]). The number of events is fixed by the schedule; only the number of steps follows the time.

use std::ops::RangeInclusive;

use crate::time_budget::cost::ScheduleCost;
use crate::time_budget::rates::Rate;
use crate::time_budget::timeline::{PlanChange, Timeline};

/// Seconds after which a measured step has 1/e of its weight, as a share of the budget.
const MEMORY: f64 = 0.04;
/// Time between two plans, as a share of the budget.
const EVERY: f64 = 0.03;
/// Time before the first plan, as a share of the budget, and the least number of steps before it.
const MEASURED: f64 = 0.02;
const MEASURED_STEPS: u32 = 8;
/// Smallest change of the remaining steps that is worth a new plan.
const LEAST_CHANGE: f64 = 0.01;
/// Remaining steps per remaining position: the range that a plan may choose.
const STRETCH: RangeInclusive<f64> = 0.05..=50.0;
/// Largest factor by which one plan changes the number of remaining steps. Before the first event of a kind, its cost is only an
/// estimate, and a wrong early plan skips steps that no later plan can restore.
const LARGEST_CHANGE: f64 = 2.0;
/// Cost of a restart relative to its prior in [`ScheduleCost`], until one was measured. Restarts of real captures took
/// 1.1 to 1.6 times the prior.
const RESTART_PRIOR: f64 = 1.3;
/// Share of the schedule from which no new plan is made: there are too few steps left.
const LAST_PLAN: f64 = 0.98;
/// The reason that the plan records.
pub const WHY_TIME: &str = "time";

/// Rates of the kinds of work.
#[derive(Debug, Clone)]
struct Rates {
    step: Rate,
    measurement: Rate,
    restart: Rate,
    comparison: Rate,
}

/// What remains of a training, in seconds by the current rates.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Remaining {
    /// One step at each remaining position.
    steps: f64,
    /// Measurements, restarts and comparisons.
    events: f64,
}

/// Measures a training and plans its remaining steps. All times are seconds of the budget, which a caller passes.
#[derive(Debug, Clone)]
pub struct Pacer {
    budget: f64,
    cost: ScheduleCost,
    /// Cost from each position to the end of the schedule; one more entry than positions.
    left: Vec<Work>,
    rates: Rates,
    /// Time of the last call.
    last: f64,
    /// Completed steps at the last call.
    last_step: u32,
    /// Time and steps at the start of this run.
    start: (f64, u32),
    next_plan: f64,
    /// Time after the last step, as a number of last steps.
    finish_steps: f64,
    /// Measured time after the last step, seconds, which replaces `finish_steps`.
    finish: Option<f64>,
    /// Time of other work that is still to come between the steps, seconds.
    reserve: f64,
    /// Whether a plan may add steps.
    may_extend: bool,
}

impl Pacer {
    /// Measures from `now`, after `step` steps. `finish_steps` is the expected time of the work after the last step, as
    /// a number of last steps.
    pub fn new(budget: f64, cost: ScheduleCost, now: f64, step: u32, finish_steps: f64) -> Self {
        let memory = (MEMORY * budget).max(1.0);
        let rates = Rates {
            step: Rate::new(memory),
            measurement: Rate::new(memory),
            // A training has at most five restarts. The newest one has the largest weight.
            restart: Rate::new(memory),
            comparison: Rate::new(memory),
        };
        let next_plan = now + (MEASURED * budget).max(1.0);
        let (last, last_step, start) = (now, step, (now, step));
        let (finish, reserve, may_extend) = (None, 0.0, true);
        Self {
            budget,
            left: left_from(&cost),
            cost,
            rates,
            last,
            last_step,
            start,
            next_plan,
            finish_steps,
            finish,
            reserve,
            may_extend,
        }
    }

    /// Records that the training has completed `step` steps at `now`.
    pub fn note(&mut self, timeline: &Timeline, step: u32, now: f64) {
        if !now.is_finite() {
            return;
        }
        let seconds = (now - self.last).max(0.0);
        let before = std::mem::replace(&mut self.last_step, step);
        self.last = now;
        if step != before + 1 {
            // A roll-back: its time belongs to no step.
            return;
        }
        let work = self.work(timeline, before);
        if !work.has_events() {
            return self.rates.step.record(seconds, work.step);
        }
        let Some(rate) = self.rates.step.per_cost() else { return };
        // One kind of event gets the time that the others are not expected to take.
        let expected = self.expected(work, rate);
        let rest = |of: f64| (seconds - (expected.total() - of)).max(0.0);
        if work.restart > 0.0 {
            self.rates.restart.record(rest(expected.restart), work.restart);
        } else if work.comparison > 0.0 {
            self.rates.comparison.record(rest(expected.comparison), work.comparison);
        } else if work.measurement > 0.0 {
            self.rates.measurement.record(rest(expected.measurement), work.measurement);
        }
    }

    /// Time passes that belongs to no step.
    pub fn skip_to(&mut self, now: f64) {
        self.last = now;
    }

    /// Sets the measured time of the work after the last step, seconds.
    pub fn set_finish(&mut self, seconds: f64) {
        if seconds.is_finite() && seconds >= 0.0 {
            self.finish = Some(seconds);
        }
    }

    /// Sets the time of other work that is still to come between the steps, seconds.
    pub fn set_reserve(&mut self, seconds: f64) {
        if seconds.is_finite() {
            self.reserve = seconds.max(0.0);
        }
    }

    /// No later plan adds steps: the training is completing its schedule.
    pub fn only_shorten(&mut self) {
        self.may_extend = false;
    }

    /// Expected end of everything by the current plan, seconds of the budget; `None` before the first step.
    pub fn end(&self, timeline: &Timeline) -> Option<f64> {
        let step = self.last_step;
        let left = self.remaining(timeline, step)?;
        let positions = f64::from(timeline.positions() - timeline.position(step)).max(1.0);
        let stretch = f64::from(timeline.total().saturating_sub(step)) / positions;
        Some(self.last + left.steps * stretch + left.events + self.reserve + self.finish_seconds()?)
    }

    /// A new plan, if one is due and differs from the current one.
    pub fn plan(&mut self, timeline: &Timeline) -> Option<PlanChange> {
        let (now, step) = (self.last, self.last_step);
        let is_measured = step >= self.start.1 + MEASURED_STEPS;
        let position = timeline.position(step);
        let is_late = f64::from(position) >= LAST_PLAN * f64::from(timeline.positions());
        if now < self.next_plan || !is_measured || is_late || !timeline.may_change(step) {
            return None;
        }
        let left = self.remaining(timeline, step)?;
        let time = self.budget - now - self.finish_seconds()? - self.reserve - left.events;
        self.next_plan = now + (EVERY * self.budget).max(0.5);
        let positions = f64::from(timeline.positions() - position);
        let planned = f64::from(timeline.total() - step);
        let current = planned / positions;
        let stretch = (time / left.steps.max(1e-12))
            .clamp(current / LARGEST_CHANGE, current * LARGEST_CHANGE)
            .clamp(*STRETCH.start(), *STRETCH.end());
        let steps = (positions * stretch).round().max(1.0);
        let steps = if self.may_extend { steps } else { steps.min(planned) };
        if (steps / planned - 1.0).abs() < LEAST_CHANGE {
            return None;
        }
        let total = step.saturating_add(steps as u32);
        Some(PlanChange { step, position, total, why: WHY_TIME.to_owned() })
    }

    /// Cost of the step after `step` steps and of its events.
    fn work(&self, timeline: &Timeline, step: u32) -> Work {
        let (before, after) = (timeline.covered(step), timeline.reached(step + 1));
        let cost = &self.cost;
        Work {
            step: cost.step(timeline.position(step)),
            measurement: before.clone().map(|p| cost.measurements(p)).sum(),
            restart: before.clone().map(|p| cost.restart(p)).sum(),
            comparison: before.map(|p| cost.comparison(p)).sum(),
            decision: after.map(|p| cost.decisions(p)).sum(),
        }
    }

    /// Expected seconds of `work`, given the rate of steps.
    fn expected(&self, work: Work, step: f64) -> Work {
        let rates = &self.rates;
        let rate = |rate: &Rate, prior: f64| rate.per_cost().unwrap_or(prior * step);
        Work {
            step: step * work.step,
            measurement: rate(&rates.measurement, 1.0) * work.measurement,
            restart: rate(&rates.restart, RESTART_PRIOR) * work.restart,
            comparison: rate(&rates.comparison, 1.0) * work.comparison,
            // Too few, and too different, for a rate of their own.
            decision: step * work.decision,
        }
    }

    /// What remains after `step` steps; `None` before the first measured step.
    fn remaining(&self, timeline: &Timeline, step: u32) -> Option<Remaining> {
        let rate = self.rates.step.per_cost()?;
        // The events of the current position are still to come.
        let first = match timeline.covered(step) {
            range if range.is_empty() => timeline.position(step) + 1,
            range => *range.start(),
        };
        let from = |position: u32| self.left[(position as usize).min(self.left.len() - 1)];
        let steps = from(timeline.position(step)).step;
        let events = self.expected(Work { step: 0.0, ..from(first) }, rate).total();
        Some(Remaining { steps: rate * steps, events })
    }

    /// Time after the last step, seconds.
    fn finish_seconds(&self) -> Option<f64> {
        let expected = || Some(self.finish_steps * self.cost.last_step() * self.rates.step.per_cost()?);
        self.finish.or_else(expected)
    }
}

/// Relative cost, or seconds, of steps, and of the events before and after them.
#[derive(Debug, Clone, Copy, Default)]
struct Work {
    step: f64,
    measurement: f64,
    restart: f64,
    comparison: f64,
    decision: f64,
}

impl Work {
    fn has_events(self) -> bool {
        self.measurement > 0.0 || self.restart > 0.0 || self.comparison > 0.0 || self.decision > 0.0
    }

    fn total(self) -> f64 {
        self.step + self.measurement + self.restart + self.comparison + self.decision
    }
}

/// The cost from each position to the end of the schedule.
fn left_from(cost: &ScheduleCost) -> Vec<Work> {
    let mut left = vec![Work::default(); cost.positions() as usize + 1];
    for position in (0..cost.positions()).rev() {
        let after = left[position as usize + 1];
        left[position as usize] = Work {
            step: after.step + cost.step(position),
            measurement: after.measurement + cost.measurements(position),
            restart: after.restart + cost.restart(position),
            comparison: after.comparison + cost.comparison(position),
            decision: after.decision + cost.decisions(position + 1),
        };
    }
    left
}
