//! Publishing the model of a finished training.

use crate::formats::{model_file, ply_model};
use crate::jobs::Lease;
use crate::scene::Model;
use crate::store::{LeaseStatus, ModelFile, ModelRecord, StoreError};
use crate::train::Trainer;
use crate::worker::training::outcome::{AttemptEnd, AttemptError, settle};

/// Writes the model's files, then publishes them and ends the job in one transaction.
pub(super) async fn publish(lease: &Lease, trainer: &Trainer) -> Result<AttemptEnd, AttemptError> {
    let (job, model) = (lease.job(), &trainer.model()?);
    let encoded = model_file::encode(model).map_err(|e| AttemptError::new("model_invalid", e.to_string()))?;
    let files = [
        store_file(lease, "model.safetensors", "application/octet-stream", encoded).await?,
        store_file(lease, "model.ply", "application/octet-stream", ply_model::encode(model)).await?,
    ];
    let record = ModelRecord {
        id: lease.jobs().fresh_id(),
        job_id: job.id.clone(),
        capture_id: job.request.capture.clone(),
        gaussians: i64::try_from(model.gaussians.len()).unwrap_or(i64::MAX),
        card: timed_card(trainer, model),
        created_ms: lease.jobs().now_ms(),
    };
    match lease.publish(&record, &files).await? {
        LeaseStatus::Held => Ok(AttemptEnd::Published),
        LeaseStatus::Cancelling | LeaseStatus::Lost => Ok(settle(lease).await?),
    }
}

/// The model's card with the time it took, which the file leaves out so that its bytes depend on the job alone.
fn timed_card(trainer: &Trainer, model: &Model) -> serde_json::Value {
    let mut card = model.card.clone();
    if let Some(fields) = card.as_object_mut() {
        fields.insert("training_seconds".to_owned(), trainer.seconds().into());
    }
    card
}

async fn store_file(
    lease: &Lease,
    name: &str,
    content_type: &str,
    bytes: Vec<u8>,
) -> Result<ModelFile, StoreError> {
    let artifact = format!("{}/{name}", lease.artifact_prefix());
    let size = i64::try_from(bytes.len()).unwrap_or(i64::MAX);
    let sha256 = lease.jobs().store().artifacts().put(&artifact, bytes).await?;
    Ok(ModelFile {
        name: name.to_owned(),
        content_type: content_type.to_owned(),
        bytes: size,
        sha256,
        artifact,
    })
}
