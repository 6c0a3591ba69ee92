//! The up direction of the world of a model. A model or checkpoint of a capture without a stated direction has the world that was
//! estimated at its import, and records it: later versions, or other photographs of the capture, may give another estimate.

use relume_capture::{Up, WorldUp};
use relume_spec::training::UpAxis;
use serde::Deserialize;
use serde_json::Value;

use crate::{TrainError, checkpoint};

/// Largest distance between two equal unit vectors, one of which was read from a file.
const SAME: f64 = 1e-9;

/// The direction with which a capture is imported into the world of a model with this card: the recorded one; in cards without
/// one, that of the setting `up`, and for `auto` [`Up::MEAN`].
///
/// # Errors
/// [`TrainError::Invalid`] if the card has another value.
pub fn up_of_card(card: &Value) -> Result<Up, TrainError> {
    let invalid = |field: &str, error: &dyn std::fmt::Display| {
        TrainError::Invalid(format!("the model card: {field}: {error}; train the model again"))
    };
    let recorded = card.get("up").filter(|value| !value.is_null());
    let recorded = recorded.map(WorldUp::deserialize).transpose().map_err(|error| invalid("up", &error))?;
    let axis = card.pointer("/config/up").map(UpAxis::deserialize).transpose();
    up(axis.map_err(|error| invalid("config.up", &error))?.unwrap_or_default(), recorded.as_ref())
        .ok_or_else(|| invalid("up.direction", &"is not a direction"))
}

/// The direction with which a capture is imported for a training that resumes from a checkpoint; see [`up_of_card`].
///
/// # Errors
/// [`TrainError::Checkpoint`] if the header is damaged, of another version, or records no direction but other numbers.
pub fn up_of_checkpoint(bytes: &[u8]) -> Result<Up, TrainError> {
    let (axis, recorded) = checkpoint::up(bytes)?;
    let invalid = || TrainError::Checkpoint("up.direction: is not a direction".to_owned());
    up(axis, recorded.as_ref()).ok_or_else(invalid)
}

fn up(axis: UpAxis, recorded: Option<&WorldUp>) -> Option<Up> {
    match recorded {
        Some(world) => Up::direction(world.direction),
        None if axis.is_auto() => Some(Up::MEAN),
        None => Some(axis.into()),
    }
}

/// Checks that a capture has the world of a checkpoint, which recorded `recorded`. An older checkpoint recorded none; then the
/// direction must not be a new estimate.
///
/// # Errors
/// [`TrainError::Checkpoint`] if the world is another one.
pub(crate) fn check(recorded: Option<&WorldUp>, capture: &WorldUp) -> Result<(), TrainError> {
    let is_same =
        |recorded: &WorldUp| (0..3).all(|i| (recorded.direction[i] - capture.direction[i]).abs() < SAME);
    if recorded.map_or(capture.note.is_none(), is_same) {
        return Ok(());
    }
    let recorded = recorded.map_or_else(|| "none".to_owned(), |up| format!("{:?}", up.direction));
    Err(TrainError::Checkpoint(format!(
        "up: the checkpoint has the up direction {recorded}, the capture {:?}; import the capture in the world of the checkpoint",
        capture.direction
    )))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn recorded_direction_precedes_the_setting() {
        let recorded =
            json!({ "up": { "direction": [0.0, 0.6, 0.8], "note": null }, "config": { "up": "x" } });
        assert_eq!(up_of_card(&recorded).unwrap(), Up::direction([0.0, 0.6, 0.8]).unwrap());
        assert_eq!(up_of_card(&json!({ "config": { "up": "x" } })).unwrap(), UpAxis::X.into());
        for card in [json!(null), json!({ "config": {} }), json!({ "up": null })] {
            assert_eq!(up_of_card(&card).unwrap(), Up::MEAN, "{card}");
        }
        for bad in [json!({ "up": { "direction": [0, 0, 0] } }), json!({ "up": [1, 2] })] {
            let error = up_of_card(&bad).unwrap_err().to_string();
            assert!(error.contains("the model card: up"), "{error}");
        }
        assert!(up_of_card(&json!({ "config": { "up": "w" } })).is_err());
    }

    #[test]
    fn checkpoint_of_another_world_is_refused() {
        let of = |direction| WorldUp { direction, note: None };
        let z = of([0.0, 0.0, 1.0]);
        assert!(check(Some(&z), &of([0.0, 1e-12, 1.0])).is_ok());
        for direction in [[0.0, 0.6, 0.8], [f64::NAN; 3]] {
            assert!(check(Some(&of(direction)), &z).is_err(), "{direction:?}");
        }
        let estimate = WorldUp { note: Some("up: a new estimate".to_owned()), ..z.clone() };
        assert!(check(None, &z).is_ok() && check(None, &estimate).is_err(), "an older checkpoint");
    }
}
