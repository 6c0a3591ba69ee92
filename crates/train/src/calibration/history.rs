//! The calibrations of a model, according to its card.

use serde_json::{Value, json};

use crate::calibration::scale_model;
use relume_scene::Model;

/// The entry of the model card.
const ENTRY: &str = "calibration";
/// Its field with the factor of all calibrations since the training.
const TOTAL_SCALE: &str = "total_scale";
/// Its field with the calibration that was part of the training.
const IN_TRAINING: &str = "in_training";

/// When a model is calibrated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CalibrationTime {
    /// At the end of its training. [`undo_calibration`] does not undo it.
    InTraining,
    /// Afterwards. The entry of the card then also has `total_scale`, the product of the factors of all calibrations since the training, and
    /// `in_training`, the calibration that was part of the training, if any.
    Finished,
}

/// Records a calibration by the factor `scale` on the albedo in the card of `model`, if it has one.
pub(super) fn record(model: &mut Model, mut entry: Value, scale: [f32; 3], time: CalibrationTime) {
    if time == CalibrationTime::Finished {
        let before = model.card.get(ENTRY).cloned().unwrap_or_default();
        let (total, in_training) = match total_scale(&model.card) {
            Some(total) => (total, before.get(IN_TRAINING).cloned().unwrap_or_default()),
            None => ([1.0; 3], before),
        };
        let total: [f32; 3] = std::array::from_fn(|c| total[c] * scale[c]);
        entry[TOTAL_SCALE] = json!(total);
        if !in_training.is_null() {
            entry[IN_TRAINING] = in_training;
        }
    }
    if model.card.is_object() {
        model.card[ENTRY] = entry;
    }
}

/// Undoes all calibrations since the training, up to rounding. Returns `false` if there is none; the model is then unchanged.
pub fn undo_calibration(model: &mut Model) -> bool {
    let Some(total) = total_scale(&model.card) else { return false };
    scale_model(model, total.map(f32::recip));
    let in_training = model.card[ENTRY].get(IN_TRAINING).cloned();
    if let Some(card) = model.card.as_object_mut() {
        match in_training {
            Some(entry) => card.insert(ENTRY.to_owned(), entry),
            None => card.remove(ENTRY),
        };
    }
    true
}

/// Product of the factors on the albedo of all calibrations since the training, by channel, according to a model card; `None` if
/// there is no such calibration.
pub fn total_scale(card: &Value) -> Option<[f32; 3]> {
    let total: [f32; 3] = serde_json::from_value(card.get(ENTRY)?.get(TOTAL_SCALE)?.clone()).ok()?;
    total.iter().all(|factor| factor.is_finite() && *factor > 0.0).then_some(total)
}
