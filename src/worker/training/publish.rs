//! Publishing the model of a finished training.

use crate::api::quality::Figures;
use crate::formats::{model_file, ply_model};
use crate::jobs::Lease;
use crate::scene::Model;
use crate::store::{LeaseStatus, ModelFile, ModelRecord, StoreError};
use crate::worker::training::outcome::{AttemptEnd, AttemptError, settle};

/// Names of a model's files.
const MODEL: &str = "model.safetensors";
const POINTS: &str = "model.ply";

/// Writes the files of a model that was trained for `seconds`, then publishes them and ends the job in one transaction. What was written and is not published is
/// removed.
pub(super) async fn publish(
    lease: &Lease,
    seconds: f64,
    model: &Model,
    figures: Figures,
) -> Result<AttemptEnd, AttemptError> {
    let encoded = model_file::encode(model).map_err(|e| AttemptError::new("model_invalid", e.to_string()))?;
    let points = ply_model::encode(model);
    let size = (encoded.len() + points.len()) as u64;
    let record = record(lease, seconds, model, &figures);
    match store_and_publish(lease, record, figures, [encoded, points]).await {
        Ok(LeaseStatus::Held) => Ok(AttemptEnd::Published),
        Ok(LeaseStatus::Cancelling | LeaseStatus::Lost) => {
            discard(lease).await;
            Ok(settle(lease).await?)
        }
        Err(error) => {
            // After another failure of the database the model may be published all the same.
            if matches!(error, StoreError::Full) {
                discard(lease).await;
                lease.jobs().store().room().note_shortage(size);
            }
            Err(error.into())
        }
    }
}

fn record(lease: &Lease, seconds: f64, model: &Model, figures: &Figures) -> ModelRecord {
    let job = lease.job();
    ModelRecord {
        id: lease.jobs().fresh_id(),
        job_id: job.id.clone(),
        capture_id: job.request.capture.clone(),
        gaussians: i64::try_from(model.gaussians.len()).unwrap_or(i64::MAX),
        // The store gives it those of its job.
        marks: job.request.marks(),
        card: published_card(model, seconds, figures),
        created_ms: lease.jobs().now_ms(),
    }
}

/// The model's card with what the file leaves out, so that its bytes depend on the job alone: the time it took, and what was
/// measured on held-out views.
fn published_card(model: &Model, seconds: f64, figures: &Figures) -> serde_json::Value {
    let mut card = model.card.clone();
    if let Some(fields) = card.as_object_mut() {
        fields.insert("training_seconds".to_owned(), seconds.into());
        fields.insert("figures".to_owned(), serde_json::json!(figures));
    }
    card
}

async fn store_and_publish(
    lease: &Lease,
    record: ModelRecord,
    figures: Figures,
    [model, points]: [Vec<u8>; 2],
) -> Result<LeaseStatus, StoreError> {
    let files = [store_file(lease, MODEL, model).await?, store_file(lease, POINTS, points).await?];
    lease.publish(&record, &files, figures).await
}

async fn store_file(lease: &Lease, name: &str, bytes: Vec<u8>) -> Result<ModelFile, StoreError> {
    let artifact = key(lease, name);
    let size = i64::try_from(bytes.len()).unwrap_or(i64::MAX);
    let sha256 = lease.jobs().store().artifacts().put(&artifact, bytes).await?;
    Ok(ModelFile {
        name: name.to_owned(),
        content_type: "application/octet-stream".to_owned(),
        bytes: size,
        sha256,
        artifact,
    })
}

fn key(lease: &Lease, name: &str) -> String {
    format!("{}/{name}", lease.artifact_prefix())
}

/// Removes the files of an attempt that published nothing.
async fn discard(lease: &Lease) {
    for name in [MODEL, POINTS] {
        lease.jobs().store().artifacts().remove(&key(lease, name)).await;
    }
}
