//! Captures that are being made or are invalid, as clients see them.

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::listing::rfc3339;
use crate::server::problem::Problem;
use crate::store::UploadRecord;
use relume_api::CaptureId;
use relume_api::captures::{CaptureState, CaptureSummary};
use relume_spec::CaptureReport;

/// The view of a capture that is being made or is invalid.
pub(in crate::server) fn view(app: &AppState, upload: &UploadRecord) -> CaptureSummary {
    CaptureSummary {
        id: upload.capture_id.clone().unwrap_or_default(),
        sha256: upload.sha256.clone().unwrap_or_default(),
        bytes: upload.length,
        metadata: upload.capture_metadata.clone(),
        created_at: rfc3339(upload.created_ms),
        state: if upload.problem.is_some() { CaptureState::Invalid } else { CaptureState::Validating },
        problem: upload.problem.clone(),
        upload: Some(upload.id.clone()),
        poses: upload.capture_id.as_ref().and_then(|id| app.poses.progress(id)),
        made_of: None,
        report: CaptureReport::default(),
    }
}

/// The problem of a job whose capture `id` is not ready.
pub(in crate::server) async fn unavailable_reason(
    app: &AppState,
    caller: &Caller,
    id: &CaptureId,
) -> Result<Problem, Problem> {
    Ok(match app.store.upload_of_capture(&caller.tenant, id).await? {
        Some(UploadRecord { problem: None, .. }) => Problem::conflict(
            "capture-validating",
            "the server is validating the capture; wait until its state is ready",
        )
        .retry_after(5),
        Some(_) => Problem::invalid_field(
            "/capture",
            format!("{:?} is invalid; its problem has the reason", id.as_str()),
        ),
        None => Problem::invalid_field("/capture", format!("{:?} does not exist", id.as_str())),
    })
}
