//! Tests with simulated machines: trainings end in time on fast, slow and changing machines.

use crate::time_budget::cost::{PhotographCost, ProbeCost, ScheduleCost, StepCost};
use crate::time_budget::pacer::Pacer;
use crate::time_budget::plan::{reduced, settings_for, with_steps_for};
use crate::time_budget::timeline::{PlanChange, Timeline};
use relume_spec::training::{TrainConfig, TrainOverrides};

pub(super) const PHONE: [(u32, u32); 50] = [(1_080, 1_920); 50];
/// Time after the last step that the plan expects, as a number of last steps.
const FINISH: f64 = 40.0;
/// Seconds before the first step: measuring the machine, reading the photographs.
const BEFORE: f64 = 4.0;

/// A machine whose times differ from the cost model: pixels are cheaper relative to Gaussians, shading, measurements and
/// restarts are more expensive.
struct Machine {
    /// What the measurement before the training said.
    said: StepCost,
    /// True time divided by that of `said`.
    slower: f64,
    /// Factor on the time at `now`, seconds, in step `step`.
    busy: fn(f64, u32) -> f64,
    /// Factor on the expected time after the last step.
    finish: f64,
    /// Whether that time is measured half-way.
    measures_finish: bool,
}

impl Machine {
    fn truth(&self) -> StepCost {
        let StepCost { fixed, pixel, gaussian, probes } = self.said;
        let slower = 1.1 * self.slower;
        let probes = probes.map(|cost| ProbeCost { device: slower * cost.device, host: slower * cost.host });
        StepCost { fixed, pixel: 0.8 * self.slower * pixel, gaussian: slower * gaussian, probes }
    }

    fn finish_seconds(&self, config: &TrainConfig, photographs: PhotographCost) -> f64 {
        self.finish * FINISH * ScheduleCost::new(config, photographs, self.truth()).last_step()
    }
}

/// The end of a training with a budget on a machine, seconds, and its timeline.
fn end(machine: &Machine, budget: f64, plans_again: bool) -> (f64, Timeline) {
    let left = budget - BEFORE;
    let config =
        settings_for(&TrainOverrides::default(), &PHONE, machine.said, left, FINISH, |_| true).unwrap();
    let photographs = reduced(&PHONE, config.resolution);
    let config = with_steps_for(&config, photographs, machine.said, left, FINISH);
    let truth = ScheduleCost::new(&config, photographs, machine.truth());
    let mut timeline = Timeline::new(config.iterations);
    let cost = ScheduleCost::new(&config, photographs, machine.said);
    let mut pacer = Pacer::new(budget, cost, BEFORE, 0, FINISH);
    let finish = machine.finish_seconds(&config, photographs);
    let (mut now, mut step) = (BEFORE, 0);
    while step < timeline.total() {
        let shading = if timeline.position(step) >= config.warm_up_steps() { 1.15 } else { 1.0 };
        let mut seconds = shading * truth.step(timeline.position(step));
        for p in timeline.covered(step) {
            seconds += 1.3 * truth.measurements(p) + 1.7 * truth.restart(p) + 1.4 * truth.comparison(p);
        }
        // Most decisions follow the last step: if that were an outlier, no plan could make up for it.
        let decisions: f64 = timeline.covered(step + 1).map(|p| 1.2 * truth.decisions(p)).sum();
        now += seconds * (machine.busy)(now, step) + decisions * (machine.busy)(now, 0);
        step += 1;
        pacer.note(&timeline, step, now);
        if machine.measures_finish && now > budget / 2.0 {
            pacer.set_finish(finish * (machine.busy)(now, 0));
        }
        if let Some(change) = pacer.plan(&timeline).filter(|_| plans_again) {
            timeline.change(change).unwrap();
        }
    }
    (now + finish * (machine.busy)(now, 0), timeline)
}

/// Two cores of a server.
pub(super) const CPU: StepCost = StepCost { fixed: 1e-3, pixel: 1.4e-6, gaussian: 3.2e-6, probes: None };
const SLOW: StepCost = StepCost { fixed: 2e-3, pixel: 6e-6, gaussian: 1.4e-5, probes: None };
/// A large graphics card, whose host searches for lights.
pub(super) const GPU: StepCost = StepCost {
    fixed: 2e-3,
    pixel: 4e-9,
    gaussian: 1e-8,
    probes: Some(ProbeCost { device: 1.5e-8, host: 6e-8 }),
};
const SMALL: PhotographCost = PhotographCost { count: 50.0, pixels: 1e4 };

fn steady() -> Machine {
    Machine { said: CPU, slower: 1.0, busy: |_, _| 1.0, finish: 1.0, measures_finish: false }
}

/// Asserts that the training ends within a tenth of the budget.
fn assert_ends_in_time(name: &str, machine: &Machine, budget: f64) {
    let (ends, timeline) = end(machine, budget, true);
    assert!((ends / budget - 1.0).abs() < 0.1, "{name}: {ends} s of {budget} s");
    assert!(timeline.changes().len() < 60, "{name}: {} plans", timeline.changes().len());
}

/// Asserts that the training ends within a tenth of the budget, and without new plans does not.
fn assert_only_new_plans_end_in_time(name: &str, machine: &Machine, budget: f64) {
    assert_ends_in_time(name, machine, budget);
    let (control, _) = end(machine, budget, false);
    assert!((control / budget - 1.0).abs() > 0.1, "{name}, the control without new plans: {control} s");
}

#[test]
fn plans_end_in_time_on_fast_and_slow_machines() {
    for (name, said) in [("CPU", CPU), ("slow CPU", SLOW), ("GPU", GPU)] {
        for budget in [120.0, 1_200.0] {
            assert_ends_in_time(name, &Machine { said, ..steady() }, budget);
        }
    }
}

#[test]
fn plans_end_in_time_if_the_machine_was_misjudged() {
    for slower in [0.4, 2.0] {
        assert_only_new_plans_end_in_time("misjudged", &Machine { slower, ..steady() }, 120.0);
    }
}

#[test]
fn plans_end_in_time_if_the_machine_gets_slower() {
    let busy = |now: f64, _| if now > 60.0 { 2.0 } else { 1.0 };
    assert_only_new_plans_end_in_time("slower half-way", &Machine { busy, ..steady() }, 120.0);
}

#[test]
fn plans_end_in_time_with_jitter() {
    // Each step takes 0.7 to 1.7 times its time, and every 97th ten times.
    let busy = |_, step: u32| {
        let outlier = if step % 97 == 96 { 10.0 } else { 1.0 };
        outlier * (0.7 + f64::from(step * 7_919 % 11) / 10.0)
    };
    assert_only_new_plans_end_in_time("jitter", &Machine { busy, slower: 1.2, ..steady() }, 120.0);
}

#[test]
fn a_measured_finish_replaces_the_expected_one() {
    let machine = Machine { finish: 12.0, ..steady() };
    let (unmeasured, _) = end(&machine, 120.0, true);
    assert!(unmeasured > 1.1 * 120.0, "the control: {unmeasured}");
    assert_ends_in_time("long finish", &Machine { measures_finish: true, ..machine }, 120.0);
}

#[test]
fn a_rolled_back_step_and_nan_times_do_not_spoil_the_plan() {
    let config = TrainConfig::on_curve(0.0);
    let timeline = Timeline::new(config.iterations);
    let mut pacer = Pacer::new(60.0, ScheduleCost::new(&config, SMALL, CPU), 0.0, 0, 0.0);
    let mut now = 0.0;
    for step in 1..=40 {
        now += 0.01;
        pacer.note(&timeline, step, now);
    }
    let before = pacer.end(&timeline).unwrap();
    let is_same = |end: f64| (end / before - 1.0).abs() < 0.01;
    let mut unknown = pacer.clone();
    unknown.note(&timeline, 41, f64::NAN);
    unknown.set_finish(f64::NAN);
    unknown.set_reserve(f64::NAN);
    assert!(is_same(unknown.end(&timeline).unwrap()));
    let mut slow = pacer.clone();
    slow.note(&timeline, 41, now + 5.0);
    assert!(!is_same(slow.end(&timeline).unwrap()), "the control: five seconds of a step count");
    pacer.note(&timeline, 20, now + 5.0);
    pacer.skip_to(now);
    pacer.note(&timeline, 21, now + 0.01);
    let after = pacer.end(&timeline).unwrap();
    // Steps 21 to 40 are repeated.
    assert!((after / before - 1.0).abs() < 0.2, "{before} {after}");
}

#[test]
fn a_schedule_that_completes_is_not_extended() {
    let config = TrainConfig::on_curve(0.0);
    let mut timeline = Timeline::new(config.iterations);
    let jump = PlanChange { step: 600, position: 1_350, total: 660, why: "until".to_owned() };
    let run = |only_shorten: bool, timeline: &Timeline| {
        let mut pacer = Pacer::new(600.0, ScheduleCost::new(&config, SMALL, CPU), 0.0, 600, 0.0);
        if only_shorten {
            pacer.only_shorten();
        }
        for step in 601..=625 {
            pacer.note(timeline, step, f64::from(step - 600) * 0.6);
        }
        pacer.plan(timeline)
    };
    timeline.change(jump).unwrap();
    assert_eq!(run(true, &timeline), None);
    assert!(run(false, &timeline).unwrap().total > 660, "the control");
}
