//! A plan that a model card or a file records, so that the training can be repeated without a clock.

use serde::Deserialize;
use serde_json::{Value, json};

use crate::TrainError;
use crate::time_budget::timeline::{PlanChange, Timeline};
use relume_spec::training::TrainConfig;

/// Field of the plan in the model card.
const FIELD: &str = "time_plan";

/// Settings and plan of a training that was planned on the way.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedPlan {
    /// All settings.
    pub config: TrainConfig,
    /// The steps.
    pub timeline: Timeline,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StoredPlan {
    positions: u32,
    changes: Vec<PlanChange>,
}

impl RecordedPlan {
    /// The plan in a model card: `{"config": {...}, "time_plan": {"positions": N, "changes": [...]}}`. A card without
    /// `time_plan` is of a training whose steps never changed.
    ///
    /// # Errors
    /// [`TrainError::Invalid`] names the field that is missing or wrong.
    pub fn of_card(card: &Value) -> Result<Self, TrainError> {
        let invalid = |field: &str, why: &dyn std::fmt::Display| {
            TrainError::Invalid(format!(
                "plan: {field}: {why}; give a model of `relume train --time`, or its card as JSON"
            ))
        };
        let config = card.get("config").ok_or_else(|| invalid("config", &"is missing"))?;
        let config = TrainConfig::deserialize(config).map_err(|error| invalid("config", &error))?;
        config.validate().map_err(|error| invalid("config", &error))?;
        let timeline = match card.get(FIELD) {
            None => Timeline::new(config.iterations),
            Some(stored) => {
                let stored = StoredPlan::deserialize(stored).map_err(|error| invalid(FIELD, &error))?;
                if stored.positions != config.iterations {
                    return Err(invalid("time_plan.positions", &"must equal config.iterations"));
                }
                let timeline = Timeline::with_changes(stored.positions, stored.changes);
                timeline.map_err(|error| invalid(FIELD, &error))?
            }
        };
        Ok(Self { config, timeline })
    }
}

/// The plan for the model card; `None` if no plan was made on the way.
pub fn card(config: &TrainConfig, timeline: &Timeline) -> Option<(&'static str, Value)> {
    let is_planned =
        config.time_budget_s.is_some() || config.until.is_some() || !timeline.changes().is_empty();
    is_planned.then(|| {
        let changes = timeline.changes();
        (FIELD, json!({ "positions": timeline.positions(), "changes": changes }))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_spec::training::Preset;

    fn planned() -> (TrainConfig, Timeline) {
        let config = TrainConfig { time_budget_s: Some(60), ..TrainConfig::preset(Preset::Draft) };
        let change = PlanChange { step: 10, position: 10, total: 700, why: "time".to_owned() };
        let timeline = Timeline::with_changes(config.iterations, vec![change]).unwrap();
        (config, timeline)
    }

    fn card_of(config: &TrainConfig, timeline: &Timeline) -> Value {
        let mut whole = json!({ "config": config });
        if let Some((field, value)) = card(config, timeline) {
            whole[field] = value;
        }
        whole
    }

    #[test]
    fn a_recorded_plan_is_read_back() {
        let (config, timeline) = planned();
        let recorded = RecordedPlan::of_card(&card_of(&config, &timeline)).unwrap();
        assert_eq!(recorded, RecordedPlan { config, timeline });
        let config = TrainConfig::preset(Preset::Draft);
        let whole = card_of(&config, &Timeline::new(1_500));
        assert!(whole.get("time_plan").is_none(), "a training without a budget records none");
        let recorded = RecordedPlan::of_card(&whole).unwrap();
        assert_eq!(recorded.timeline, Timeline::new(1_500));
    }

    #[test]
    fn damaged_plans_are_refused_by_field() {
        let (config, timeline) = planned();
        let whole = card_of(&config, &timeline);
        let with = |pointer: &str, value: Value| {
            let mut card = whole.clone();
            *card.pointer_mut(pointer).unwrap() = value;
            RecordedPlan::of_card(&card).map_err(|error| error.to_string())
        };
        for (pointer, value, named) in [
            ("/config", Value::Null, "config"),
            ("/config/resolution", json!(0), "resolution"),
            ("/time_plan", json!([]), "time_plan"),
            ("/time_plan/positions", json!(7), "time_plan.positions"),
            ("/time_plan/changes/0/total", json!(3), "time_plan.changes[0].total"),
            ("/time_plan/changes/0/why", json!(3), "time_plan"),
        ] {
            let error = with(pointer, value).unwrap_err();
            assert!(error.contains(named), "{pointer}: {error}");
        }
        assert!(with("/time_plan/changes/0/total", json!(800)).is_ok(), "the control");
        let error = RecordedPlan::of_card(&json!({})).unwrap_err().to_string();
        assert!(error.contains("config"), "{error}");
    }
}
