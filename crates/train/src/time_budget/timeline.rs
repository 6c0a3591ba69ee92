//! The position of each step in the schedule of a training whose number of steps may change on the way.
//!
//! The schedule has `positions` positions, the number of iterations of the configuration. All weights, step sizes and
//! events (start of the materials, measurements, restarts, rounds of density control) belong to positions. Without a
//! change, step k is at position k. After a change, the remaining steps are spread evenly over the remaining
//! positions: with fewer steps a step passes several positions, with more steps several steps share one.

use serde::{Deserialize, Serialize};

use crate::TrainError;

/// Greatest number of changes of one plan.
const MAX_CHANGES: usize = 1_000;
/// Greatest number of steps of a plan.
const MAX_STEPS: u32 = 100_000_000;

/// A change of the number of steps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanChange {
    /// Completed steps when the plan changed.
    pub step: u32,
    /// Position from which the training continues. If it is beyond the position of `step`, the events between the two
    /// are left out.
    pub position: u32,
    /// Number of steps of the training by the new plan.
    pub total: u32,
    /// Why the plan changed, for the reader of the model card.
    pub why: String,
}

/// The plan so far.
#[derive(Debug, Clone, PartialEq)]
pub struct Timeline {
    positions: u32,
    changes: Vec<PlanChange>,
}

impl Timeline {
    /// A plan without changes: as many steps as positions.
    pub fn new(positions: u32) -> Self {
        Self { positions, changes: Vec::new() }
    }

    /// A recorded plan.
    ///
    /// # Errors
    /// [`TrainError::Invalid`] names the first change that cannot follow the ones before it.
    pub fn with_changes(positions: u32, changes: Vec<PlanChange>) -> Result<Self, TrainError> {
        let mut timeline = Self::new(positions);
        changes.into_iter().try_for_each(|change| timeline.change(change))?;
        Ok(timeline)
    }

    /// Adds a change.
    ///
    /// # Errors
    /// [`TrainError::Invalid`] if it does not follow the changes so far; the plan is then unchanged.
    pub fn change(&mut self, change: PlanChange) -> Result<(), TrainError> {
        let invalid = |field: &str, reason: &str| {
            Err(TrainError::Invalid(format!("time_plan.changes[{}].{field}: {reason}", self.changes.len())))
        };
        if self.changes.len() >= MAX_CHANGES {
            return invalid("step", "a plan has at most 1000 changes");
        }
        if self.changes.last().is_some_and(|last| change.step <= last.step) || change.step >= self.total() {
            return invalid("step", "must be after the previous change and before the last step");
        }
        if change.position < self.position(change.step) || change.position >= self.positions {
            return invalid("position", "must not go back, and must be before the end of the schedule");
        }
        if change.total <= change.step || change.total > MAX_STEPS {
            return invalid("total", "must be more than `step` and at most 100000000");
        }
        self.changes.push(change);
        Ok(())
    }

    /// Whether the plan may change after `step` steps. After a roll-back it may not, until the training has passed its last
    /// change again.
    pub fn may_change(&self, step: u32) -> bool {
        let is_after_last = self.changes.last().is_none_or(|last| step > last.step);
        self.changes.len() < MAX_CHANGES && step < self.total() && is_after_last
    }

    /// The changes so far, in order.
    pub fn changes(&self) -> &[PlanChange] {
        &self.changes
    }

    /// Number of positions of the schedule.
    pub fn positions(&self) -> u32 {
        self.positions
    }

    /// Number of steps by the current plan.
    pub fn total(&self) -> u32 {
        self.changes.last().map_or(self.positions, |change| change.total)
    }

    /// Position after `step` steps, 0 to [`Self::positions`]. It never decreases with the step.
    pub fn position(&self, step: u32) -> u32 {
        let Some(change) = self.change_at(step) else { return step.min(self.positions) };
        if step >= change.total {
            return self.positions;
        }
        let (steps, left) = (u64::from(step - change.step), u64::from(self.positions - change.position));
        change.position + (steps * left / u64::from(change.total - change.step)) as u32
    }

    /// Progress after `step` steps, 0 to 1. Without changes this is exactly step / positions in single precision.
    pub fn progress(&self, step: u32) -> f32 {
        let exact = match self.change_at(step) {
            None => f64::from(step),
            Some(change) => {
                let (steps, left) =
                    (f64::from(step - change.step), f64::from(self.positions - change.position));
                f64::from(change.position) + steps * left / f64::from(change.total - change.step)
            }
        };
        exact as f32 / self.positions as f32
    }

    /// The positions whose events are due before the step after `step` steps. Each position is in the range of exactly
    /// one step, unless a change has left it out. The range may be empty.
    pub fn covered(&self, step: u32) -> std::ops::RangeInclusive<u32> {
        let last = self.position(step);
        if step == 0 {
            return last..=last;
        }
        let before = self.position(step - 1);
        let change = self.change_at(step).filter(|change| change.step == step);
        match change {
            Some(change) if change.position > self.without_last_change(change).position(step) => last..=last,
            _ => before + 1..=last,
        }
    }

    /// The positions that step `step` reached, by the plan with which it was taken: a change after this step does not count.
    pub fn reached(&self, step: u32) -> std::ops::RangeInclusive<u32> {
        match self.change_at(step).filter(|change| change.step == step) {
            Some(change) => self.without_last_change(change).covered(step),
            None => self.covered(step),
        }
    }

    /// The first step at `position` or beyond; the total if there is none.
    pub fn step_of(&self, position: u32) -> u32 {
        if self.changes.is_empty() {
            return position.min(self.positions);
        }
        let (mut low, mut high) = (0, self.total());
        while low < high {
            let middle = low + (high - low) / 2;
            if self.position(middle) >= position { high = middle } else { low = middle + 1 }
        }
        low
    }

    /// The last change at or before `step`.
    fn change_at(&self, step: u32) -> Option<&PlanChange> {
        self.changes.iter().rev().find(|change| change.step <= step)
    }

    /// The plan before `change`.
    fn without_last_change(&self, change: &PlanChange) -> Self {
        let changes = self.changes.iter().filter(|other| other.step < change.step).cloned().collect();
        Self { positions: self.positions, changes }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn change(step: u32, position: u32, total: u32) -> PlanChange {
        PlanChange { step, position, total, why: "time".to_owned() }
    }

    #[test]
    fn a_plan_without_changes_has_one_position_a_step() {
        for positions in [1, 7, 1_500, 6_001] {
            let timeline = Timeline::new(positions);
            assert_eq!(timeline.total(), positions);
            for step in 0..=positions {
                assert_eq!(timeline.position(step), step);
                assert_eq!(timeline.covered(step), step..=step);
                assert_eq!(timeline.step_of(step), step);
                assert_eq!(timeline.progress(step), step as f32 / positions as f32);
            }
        }
    }

    #[test]
    fn each_position_is_covered_once_whatever_changes() {
        let plans = [
            vec![change(100, 100, 400)],
            vec![change(100, 100, 5_000), change(900, 246, 901)],
            vec![change(1, 1, 33), change(2, 32, 900), change(500, 568, 600), change(590, 990, 700)],
        ];
        for changes in plans {
            let jumps: Vec<bool> = changes
                .iter()
                .enumerate()
                .map(|(k, c)| {
                    let before = Timeline::with_changes(1_000, changes[..k].to_vec()).unwrap();
                    c.position > before.position(c.step)
                })
                .collect();
            let has_jump = jumps.contains(&true);
            let timeline = Timeline::with_changes(1_000, changes).unwrap();
            let mut seen = vec![0u32; 1_001];
            let mut last = 0;
            for step in 0..=timeline.total() {
                assert!(timeline.position(step) >= last, "step {step}");
                last = timeline.position(step);
                timeline.covered(step).for_each(|position| seen[position as usize] += 1);
                assert!((0.0..=1.0).contains(&timeline.progress(step)));
            }
            assert_eq!(last, 1_000, "the last step ends the schedule");
            assert!(seen.iter().all(|count| *count <= 1), "no event twice");
            assert_eq!(seen.contains(&0), has_jump, "no event is lost without a jump");
            for position in [0, 1, 250, 999] {
                let step = timeline.step_of(position);
                assert!(timeline.position(step) >= position);
                assert!(step == 0 || timeline.position(step - 1) < position);
            }
        }
    }

    #[test]
    fn later_changes_do_not_move_earlier_steps() {
        let mut timeline = Timeline::with_changes(1_000, vec![change(100, 100, 400)]).unwrap();
        let before: Vec<_> =
            (0..=200).map(|step| (timeline.position(step), timeline.covered(step))).collect();
        let material = timeline.step_of(250);
        timeline.change(change(200, timeline.position(200), 900)).unwrap();
        let after: Vec<_> = (0..=200).map(|step| (timeline.position(step), timeline.covered(step))).collect();
        assert_eq!(before, after);
        assert_eq!(timeline.step_of(250), material, "an event of the past keeps its step");
        assert_eq!(timeline.total(), 900, "the control");
    }

    #[test]
    fn a_jump_leaves_out_the_events_between() {
        let timeline = Timeline::with_changes(1_000, vec![change(400, 900, 450)]).unwrap();
        assert_eq!(timeline.covered(399), 399..=399);
        assert_eq!((timeline.reached(400), timeline.covered(400)), (400..=400, 900..=900));
        assert_eq!(timeline.position(450), 1_000);
        assert_eq!(timeline.total(), 450);
    }

    #[test]
    fn a_plan_may_change_only_after_its_last_change() {
        let timeline = Timeline::with_changes(1_000, vec![change(100, 100, 400)]).unwrap();
        assert_eq!(
            [99, 100, 101, 399, 400].map(|step| timeline.may_change(step)),
            [false, false, true, true, false]
        );
        for step in [99, 100, 400] {
            assert!(timeline.clone().change(change(step, 999, 500)).is_err(), "{step}");
        }
    }

    #[test]
    fn changes_that_cannot_follow_are_refused_by_field() {
        let start = || Timeline::with_changes(1_000, vec![change(100, 100, 400)]).unwrap();
        for (bad, field) in [
            (change(100, 100, 500), "changes[1].step"),
            (change(400, 990, 500), "changes[1].step"),
            (change(200, 100, 500), "changes[1].position"),
            (change(200, 1_000, 500), "changes[1].position"),
            (change(200, 400, 200), "changes[1].total"),
            (change(200, 400, u32::MAX), "changes[1].total"),
        ] {
            let mut timeline = start();
            let error = timeline.change(bad).unwrap_err().to_string();
            assert!(error.contains(field), "{error}");
            assert_eq!(timeline, start());
        }
        assert!(start().change(change(200, 400, 500)).is_ok(), "the control");
    }
}
