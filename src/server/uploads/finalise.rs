//! Access to complete uploads for other handlers.

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::problem::Problem;
use crate::server::uploads::finding::find_locked;
use crate::store::StagedUpload;
use relume_api::UploadId;

/// The bytes of the complete upload in a body.
pub(in crate::server) async fn finalise(
    app: &AppState,
    caller: &Caller,
    id: &UploadId,
) -> Result<StagedUpload, Problem> {
    let held = find_locked(app, caller, id).await;
    let (lock, upload) = held.map_err(|problem| match problem.status {
        404 | 410 => Problem::invalid_field("/upload", format!("{:?} does not exist", id.as_str())),
        423 => Problem::conflict("upload-locked", "another request uses the upload").retry_after(1),
        _ => problem,
    })?;
    if upload.received < upload.length {
        let detail = format!("only {} of {} bytes have arrived", upload.received, upload.length);
        return Err(Problem::conflict("upload-incomplete", detail));
    }
    let name: String = app.jobs.fresh_id();
    Ok(app.store.finalise_upload(lock, &upload, &name).await?)
}
