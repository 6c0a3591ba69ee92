//! Trainings whose steps are planned on the way, with a clock of the test: they end in time, stop on a condition, resume,
//! and are repeated from their record.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::sync::OnceLock;

use relume_capture::formats::model_file;
use relume_capture::{Capture, SyntheticOptions, synthetic};
use relume_engine::Device;
use relume_spec::training::{Complexity, Preset, TrainConfig, TrainOverrides};
use relume_train::time_budget::{Pacing, PacingStart, RecordedPlan};
use relume_train::{PreparedTraining, TrainError, Trainer, planned_config};

use crate::support::short_overrides;

const BUDGET: u32 = 30;
/// Seconds of the test's clock for a step.
const STEP: f64 = 0.2;

fn capture() -> &'static Capture {
    static CAPTURE: OnceLock<Capture> = OnceLock::new();
    CAPTURE.get_or_init(|| {
        let options = SyntheticOptions {
            train_views: 6,
            test_views: 2,
            size: 32,
            paths: 8,
            relit: BTreeMap::new(),
            ..Default::default()
        };
        synthetic(&options).unwrap()
    })
}

/// A training of 60 steps, unless its plan changes, without decisions, which would take no time by the test's clock.
fn config(until: Option<&str>, budget: Option<u32>) -> TrainConfig {
    let until = until.map(|text| text.parse().unwrap());
    let config = TrainConfig::new(Preset::Draft, &short_overrides()).unwrap();
    TrainConfig { until, time_budget_s: budget, complexity: Complexity::Full, ..config }
}

/// Trains with a clock that advances by [`STEP`] a step, at most to `stop`. Returns the time and the messages of the pacing.
fn paced(trainer: &mut Trainer, from: f64, stop: u32) -> (f64, Vec<String>) {
    let start = PacingStart { now: from, cost: None, finish_steps: 0.0 };
    let mut pacing = Pacing::new(trainer, capture(), &start).unwrap().unwrap();
    let time = Cell::new(from);
    let mut told = Vec::new();
    while !trainer.is_done() && trainer.progress().step < stop {
        trainer.step().unwrap();
        time.set(time.get() + STEP);
        told.extend(pacing.after_step(trainer, &Device::Cpu, &|| time.get()).unwrap());
    }
    (time.get(), told)
}

fn new(config: &TrainConfig) -> Trainer {
    Trainer::new(capture(), config.clone(), &Device::Cpu).unwrap()
}

fn bytes(trainer: &mut Trainer) -> Vec<u8> {
    model_file::encode(&trainer.model().unwrap()).unwrap()
}

/// The bytes of a training that repeats the plan of a card, without a clock.
fn repeated(card: &serde_json::Value) -> Vec<u8> {
    let RecordedPlan { config, timeline } = RecordedPlan::of_card(card).unwrap();
    let start = PreparedTraining::new(capture(), config).unwrap().with_timeline(timeline);
    let mut trainer = start.on(&Device::Cpu).unwrap();
    while !trainer.is_done() {
        trainer.step().unwrap();
    }
    bytes(&mut trainer)
}

#[test]
fn budgeted_training_ends_in_time_and_its_plan_repeats() {
    let mut trainer = new(&config(None, Some(BUDGET)));
    let (end, told) = paced(&mut trainer, 0.0, u32::MAX);
    assert!((end / f64::from(BUDGET) - 1.0).abs() < 0.1, "{end}");
    assert!(trainer.progress().step > 100, "the control: 60 steps take 12 s, not {end}");
    assert!(told.iter().any(|text| text.starts_with("planned: ")), "{told:?}");
    let (card, first) = (trainer.model().unwrap().card, bytes(&mut trainer));
    assert_eq!(card["steps"], trainer.progress().step);
    assert!(repeated(&card) == first, "a repeated plan must give the same bytes");
    let mut other = card.clone();
    let changes = other.pointer_mut("/time_plan/changes").unwrap().as_array_mut().unwrap();
    changes.truncate(1);
    assert!(repeated(&other) != first, "the control: another plan");
}

#[test]
fn resumed_training_counts_the_time_used_so_far() {
    let config = config(None, Some(BUDGET));
    let mut trainer = new(&config);
    let (used, _) = paced(&mut trainer, 0.0, 40);
    let checkpoint = trainer.checkpoint().unwrap();
    // The caller of a resumed training does not know what was planned.
    let stated = TrainOverrides { time_budget_s: Some(BUDGET), ..Default::default() };
    let stated = TrainConfig::new(Preset::Draft, &TrainOverrides { iterations: None, ..stated }).unwrap();
    let planned = planned_config(&checkpoint, &stated).unwrap();
    assert_eq!((planned.iterations, planned.resolution), (config.iterations, config.resolution));
    let mut trainer = Trainer::resume(capture(), config, &checkpoint, &Device::Cpu).unwrap();
    let budget = trainer.budget().unwrap();
    assert!((budget.used - used).abs() < 1e-9, "{} {used}", budget.used);
    let (end, _) = paced(&mut trainer, budget.used, u32::MAX);
    assert!((end / f64::from(BUDGET) - 1.0).abs() < 0.1, "{end}");
    let card = trainer.model().unwrap().card;
    assert!(repeated(&card) == bytes(&mut trainer), "the plan of both runs must repeat");
}

#[test]
fn training_stops_when_held_out_views_meet_the_condition() {
    let met = config(Some("novel_view.psnr>=3"), None);
    let mut trainer = new(&met);
    let (_, told) = paced(&mut trainer, 0.0, u32::MAX);
    assert!(trainer.progress().step < 40, "{}", trainer.progress().step);
    assert_eq!(trainer.position(), met.iterations, "the schedule is completed");
    assert!(told[0].starts_with("novel_view.psnr>=3 is met: "), "{told:?}");
    let card = trainer.model().unwrap().card;
    assert!(repeated(&card) == bytes(&mut trainer), "a repeated stop must give the same bytes");
    let mut unmet = new(&config(Some("novel_view.psnr>=99"), None));
    paced(&mut unmet, 0.0, u32::MAX);
    assert!(unmet.progress().step > 40, "the control: {}", unmet.progress().step);
}

#[test]
fn a_budget_and_a_condition_end_at_whichever_comes_first() {
    let mut met = new(&config(Some("novel_view.psnr>=3"), Some(BUDGET)));
    let (end, told) = paced(&mut met, 0.0, u32::MAX);
    assert!(met.is_done() && end < 0.9 * f64::from(BUDGET), "{end} {told:?}");
    let mut unmet = new(&config(Some("novel_view.psnr>=99"), Some(BUDGET)));
    let (end, told) = paced(&mut unmet, 0.0, u32::MAX);
    assert!(unmet.is_done() && end < 1.1 * f64::from(BUDGET), "{end} {told:?}");
    assert!(unmet.progress().step > met.progress().step, "the control");
}

#[test]
fn a_condition_without_held_out_views_is_refused() {
    let mut bare = capture().clone();
    bare.test.clear();
    let mut trainer = new(&config(Some("novel_view.psnr>=3"), None));
    let start = PacingStart { now: 0.0, cost: None, finish_steps: 0.0 };
    let refused = Pacing::new(&mut trainer, &bare, &start).err().unwrap();
    assert!(matches!(&refused, TrainError::Invalid(m) if m.starts_with("until: ")), "{refused}");
    let mut plain = new(&config(None, None));
    assert!(Pacing::new(&mut plain, &bare, &start).unwrap().is_none(), "the control: nothing to pace");
}

#[test]
fn a_card_without_a_budget_has_no_plan() {
    let mut trainer = new(&config(None, None));
    trainer.step().unwrap();
    assert!(trainer.model().unwrap().card.get("time_plan").is_none());
    let mut trainer = new(&config(None, Some(BUDGET)));
    trainer.step().unwrap();
    assert!(trainer.model().unwrap().card.get("time_plan").is_some(), "the control");
}
