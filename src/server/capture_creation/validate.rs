//! Checks the content of an upload.

use std::path::Path;

use crate::server::app::AppState;
use crate::server::poses;
use crate::server::problem::Problem;
use crate::store::StagedUpload;
use relume_api::TenantId;
use relume_api::problem::ContentError;
use relume_capture::{self, CaptureError, ImportOptions};
use relume_spec::CaptureReport;

/// Decodes the whole capture to check that it is valid.
pub(in crate::server) async fn validate(
    app: &AppState,
    tenant: &TenantId,
    incoming: &StagedUpload,
) -> Result<CaptureReport, Problem> {
    let path = incoming.path.clone();
    let options = ImportOptions { limits: app.limits_of_uploads(), ..ImportOptions::default() };
    let inspect = move || relume_capture::inspect(&path, &options);
    let error = match app.validators.run(tenant, inspect).await? {
        Ok(report) => return Ok(report),
        Err(error) => error,
    };
    let mut problem = refused(&error, &incoming.path);
    if matches!(error, CaptureError::UnknownLayout { .. })
        && let Some(reason) = poses::refusal(app, tenant, incoming).await?
    {
        problem.detail = problem.detail.take().map(|detail| format!("{detail}; {reason}"));
    }
    Err(problem)
}

/// The problem of the upload at `path`, with the name that the client knows instead of the path.
fn refused(error: &CaptureError, path: &Path) -> Problem {
    if !error.is_users_fault() {
        return Problem::storage_failed(error);
    }
    let kept_as = path.file_name().unwrap_or_default().to_string_lossy();
    let by_its_name = |text: &str| text.replace(kept_as.as_ref(), "archive");
    let content = ContentError {
        code: error.code().to_owned(),
        file: error.file().map(by_its_name),
        field: error.field().map(str::to_owned),
    };
    Problem::invalid_content(content, by_its_name(&error.to_string()))
}
