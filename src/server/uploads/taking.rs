//! Complete uploads, for those who make something of them.

use crate::api::{Problem, UploadId};
use crate::server::app::Shared;
use crate::server::caller::Caller;
use crate::server::uploads::finding::held;
use crate::store::Incoming;

/// The bytes of the complete upload that a body names.
pub(in crate::server) async fn take(
    app: &Shared,
    caller: &Caller,
    id: &UploadId,
) -> Result<Incoming, Problem> {
    let held = held(app, caller, id).await;
    let (hold, upload) = held.map_err(|problem| match problem.status {
        404 | 410 => Problem::invalid_field("/upload", format!("{:?} does not exist", id.as_str())),
        423 => Problem::conflict("upload-locked", "another request works on the upload").retry_after(1),
        _ => problem,
    })?;
    if upload.received < upload.length {
        let detail = format!("{} of its {} bytes have arrived", upload.received, upload.length);
        return Err(Problem::conflict("upload-incomplete", detail));
    }
    let name: String = app.jobs.fresh_id();
    Ok(app.store.take_upload(hold, &upload, &name).await?)
}
