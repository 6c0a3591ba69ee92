//! Finds the upload of a request.

use axum::http::StatusCode;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::problem::Problem;
use crate::store::{UploadLock, UploadRecord};
use relume_api::UploadId;

/// The media type of a chunk.
pub(super) const PIECE: &str = "application/offset+octet-stream";

/// The expiry time of an upload if no more bytes arrive.
pub(in crate::server) fn expiry(app: &AppState) -> i64 {
    let life = i64::try_from(app.upload_limits.life.as_millis()).unwrap_or(i64::MAX);
    app.jobs.now_ms().saturating_add(life)
}

/// An upload of the caller's tenant.
pub(super) async fn find(app: &AppState, caller: &Caller, id: &UploadId) -> Result<UploadRecord, Problem> {
    let missing = || Problem::not_found("upload", id.as_str());
    let upload = app.store.upload(&caller.tenant, id).await?.ok_or_else(missing)?;
    if upload.expires_ms <= app.jobs.now_ms() {
        let problem = Problem::new(StatusCode::GONE, "upload-expired", "The upload has expired");
        return Err(problem.detail("no bytes arrived before the expiry time; create a new upload"));
    }
    Ok(upload)
}

/// An upload of the caller's tenant, locked for this request.
pub(super) async fn find_locked(
    app: &AppState,
    caller: &Caller,
    id: &UploadId,
) -> Result<(UploadLock, UploadRecord), Problem> {
    find(app, caller, id).await?;
    let Some(lock) = app.store.lock_upload(id) else {
        let problem = Problem::new(StatusCode::LOCKED, "upload-locked", "Another request uses the upload");
        return Err(problem.detail("wait until it has ended, then get the offset").retry_after(1));
    };
    Ok((lock, find(app, caller, id).await?))
}
