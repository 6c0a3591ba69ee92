//! Publishing the model of a finished training.

use crate::worker::job_source::{Claim, TrainedModel};
use crate::worker::training::outcome::{AttemptEnd, AttemptError, stop_attempt};
use relume_api::quality::Figures;
use relume_api::work::LeaseStatus;
use relume_capture::formats::{model_file, ply_model};
use relume_scene::Model;

/// Stores the files of a model that was trained for `seconds`, publishes them and ends the job. Files that are not published are
/// removed.
pub(super) async fn publish(
    claim: &dyn Claim,
    seconds: f64,
    model: &Model,
    figures: Figures,
) -> Result<AttemptEnd, AttemptError> {
    let encoded = model_file::encode(model).map_err(|e| AttemptError::new("model_invalid", e.to_string()))?;
    let trained = TrainedModel {
        gaussians: i64::try_from(model.gaussians.len()).unwrap_or(i64::MAX),
        card: with_time(model, seconds),
        figures,
        files: vec![("model.safetensors", encoded), ("model.ply", ply_model::encode(model))],
    };
    match claim.publish(trained).await? {
        LeaseStatus::Held => Ok(AttemptEnd::Published),
        LeaseStatus::Cancelling | LeaseStatus::Lost => Ok(stop_attempt(claim).await?),
    }
}

/// The model card with the training time. The file does not contain the time, so that its bytes depend only on the job.
fn with_time(model: &Model, seconds: f64) -> serde_json::Value {
    let mut card = model.card.clone();
    if let Some(fields) = card.as_object_mut() {
        fields.insert("training_seconds".to_owned(), seconds.into());
    }
    card
}
