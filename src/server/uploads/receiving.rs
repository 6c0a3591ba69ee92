//! Receives chunks of uploads.

use axum::extract::Request;
use axum::http::StatusCode;
use futures::TryStreamExt;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::extract::{STALLED, content_length, is_too_slow, media_type};
use crate::server::problem::Problem;
use crate::server::uploads::finding::{PIECE, expiry, find_locked};
use crate::server::uploads::headers;
use crate::store::{Checksum, Piece, StoreError, UploadLock, UploadRecord};
use relume_api::UploadId;

/// Appends the chunk in a request. Returns the updated upload.
pub(super) async fn piece(
    app: &AppState,
    caller: &Caller,
    id: &UploadId,
    request: Request,
) -> Result<UploadRecord, Problem> {
    if media_type(request.headers()).as_deref() != Some(PIECE) {
        return Err(Problem::unsupported_media_type(PIECE));
    }
    let offset = headers::offset(request.headers())?;
    let checksum = headers::checksum(request.headers())?;
    let (lock, upload) = find_locked(app, caller, id).await?;
    if offset != upload.offset() {
        let detail =
            format!("the offset of the upload is {}, the offset of the part is {offset}", upload.received);
        return Err(Problem::conflict("offset-mismatch", detail));
    }
    append(app, caller, lock, upload, checksum, request).await
}

/// Appends the chunk in the request that creates an upload. If this fails, the upload is removed, because the client does not
/// know its identifier.
pub(super) async fn first_piece(
    app: &AppState,
    caller: &Caller,
    upload: UploadRecord,
    request: Request,
) -> Result<UploadRecord, Problem> {
    let id = upload.id.clone();
    let received = match (headers::checksum(request.headers()), app.store.lock_upload(&id)) {
        (Ok(checksum), Some(lock)) => append(app, caller, lock, upload, checksum, request).await,
        (Err(problem), _) => Err(problem),
        (_, None) => Err(Problem::internal("a new upload is locked")),
    };
    if received.is_err()
        && let Some(lock) = app.store.lock_upload(&id)
    {
        app.store.drop_upload(&lock).await?;
    }
    received
}

async fn append(
    app: &AppState,
    caller: &Caller,
    lock: UploadLock,
    upload: UploadRecord,
    checksum: Option<Checksum>,
    request: Request,
) -> Result<UploadRecord, Problem> {
    let left = upload.total() - upload.offset();
    if content_length(request.headers()).is_some_and(|n| n > left) {
        return Err(Problem::too_large(left));
    }
    let (app, body) = (app.clone(), request.into_body().into_data_stream());
    // A separate task, so that received bytes are kept even if the connection of the caller ends.
    let appending = tokio::spawn(async move {
        let mut stalled = false;
        let body = body.inspect_err(|error| stalled = is_too_slow(error));
        let piece = Piece { upload, lock: &lock, checksum, expires_ms: &|| expiry(&app) };
        let appended = app.store.append(piece, body).await;
        (appended, stalled)
    });
    let (appended, stalled) = appending.await.map_err(Problem::internal)?;
    match appended {
        Ok(upload) => Ok(upload),
        Err(_) if stalled => Err(Problem::timeout(STALLED)),
        Err(StoreError::ChecksumMismatch) => Err(mismatch()),
        Err(error) => Err(caller.problem_for(error)),
    }
}

/// 460, a status of the tus protocol.
fn mismatch() -> Problem {
    let status = StatusCode::from_u16(460).unwrap_or(StatusCode::BAD_REQUEST);
    Problem::new(status, "checksum-mismatch", "The checksum does not match the part")
        .detail("the server discarded the part; send it again")
}
