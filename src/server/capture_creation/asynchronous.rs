//! Answers a request before the capture is made.

use axum::Json;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use tokio::sync::Mutex;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::capture_creation::background::Creation;
use crate::server::capture_creation::unfinished;
use crate::server::problem::Problem;
use crate::server::{metadata, uploads};
use crate::store::{StagedUpload, UploadRecord};
use relume_api::captures::CaptureSummary;
use relume_api::metadata::ResourceMetadata;
use relume_api::{CaptureId, ResourceKind, ResourceName, TenantId};

const APPLIED: HeaderName = HeaderName::from_static("preference-applied");
const ASYNC: &str = "respond-async";
/// Serialises requests, so that those with the same content detect each other.
static ENQUEUE_LOCK: Mutex<()> = Mutex::const_new(());

/// Whether the caller prefers an asynchronous answer.
pub(in crate::server) fn prefers_async(headers: &HeaderMap) -> bool {
    let values = headers.get_all("prefer").iter().filter_map(|value| value.to_str().ok());
    let mut preferences = values.flat_map(|value| value.split(','));
    preferences.any(|p| p.split(';').next().unwrap_or_default().trim().eq_ignore_ascii_case(ASYNC))
}

/// Options of an asynchronous creation.
#[derive(Debug, Clone, Copy)]
pub(in crate::server) struct AsyncOptions {
    /// Whether the caller prefers an asynchronous answer.
    pub(in crate::server) was_preferred: bool,
    /// Whether the photographs have no poses, so that these are found first.
    pub(in crate::server) finds_poses: bool,
}

/// The result of a request for an asynchronous creation.
pub(in crate::server) enum AsyncOutcome {
    /// A capture is being made; this is the answer with its URL.
    Answered(Response),
    /// The same content has become a capture in the meantime; nothing is made of the upload.
    Made(Box<StagedUpload>),
}

/// Starts the creation of a capture and answers with its URL. If a capture of the same content is already being made, the answer
/// has that URL.
pub(in crate::server) async fn begin(
    app: &AppState,
    caller: &Caller,
    incoming: StagedUpload,
    metadata: ResourceMetadata,
    how: AsyncOptions,
) -> Result<AsyncOutcome, Problem> {
    let (app, tenant) = (app.clone(), caller.tenant.clone());
    // A separate task, so that a recorded capture is made even if the caller disconnects.
    let entering = app.clone();
    let entered =
        tokio::spawn(async move { enqueue(&entering, tenant, incoming, metadata, how.finds_poses).await });
    Ok(match entered.await.map_err(Problem::internal)?? {
        Enqueued::Making(upload) => {
            AsyncOutcome::Answered(accepted(unfinished::view(&app, &upload), how.was_preferred))
        }
        Enqueued::Made(incoming) => AsyncOutcome::Made(incoming),
    })
}

enum Enqueued {
    Making(Box<UploadRecord>),
    Made(Box<StagedUpload>),
}

/// Records that a capture is to be made, and starts its creation.
async fn enqueue(
    app: &AppState,
    tenant: TenantId,
    mut incoming: StagedUpload,
    metadata: ResourceMetadata,
    finds_poses: bool,
) -> Result<Enqueued, Problem> {
    let _one_by_one = ENQUEUE_LOCK.lock().await;
    // The query order matters: an upload can become a capture but not the reverse.
    if let Some(mut same) = app.store.validating(&tenant, &incoming.sha256).await? {
        let id = same.capture_id.clone().unwrap_or_default().to_string();
        let what = ResourceName::new(ResourceKind::Capture, id);
        same.capture_metadata =
            metadata::apply_metadata(app, &tenant, what, metadata, same.capture_metadata).await?;
        return Ok(Enqueued::Making(Box::new(same)));
    }
    if app.store.capture_of_content(&tenant, &incoming.sha256).await?.is_some() {
        return Ok(Enqueued::Made(Box::new(incoming)));
    }
    let capture: CaptureId = app.jobs.fresh_id();
    let bytes = i64::try_from(incoming.bytes).map_err(Problem::internal)?;
    if incoming.is_from_upload() {
        app.store.begin_validation(&incoming, &capture, &metadata).await?;
    } else {
        let upload = UploadRecord {
            id: app.jobs.fresh_id(),
            tenant: tenant.clone(),
            length: bytes,
            received: bytes,
            metadata: None,
            created_ms: app.jobs.now_ms(),
            expires_ms: uploads::expiry(app),
            capture_id: Some(capture.clone()),
            capture_metadata: metadata,
            sha256: Some(incoming.sha256.clone()),
            problem: None,
        };
        app.store.persist_upload(&mut incoming, &upload, app.upload_limits.each).await?;
    }
    let missing = || Problem::internal("a stored upload is missing");
    let upload = app.store.upload_of_capture(&tenant, &capture).await?.ok_or_else(missing)?;
    // The job is queued before the answer, so that the client can cancel it.
    let pose_job = finds_poses.then(|| app.poses.enqueue(&capture));
    Creation { app: app.clone(), tenant, capture }.start(incoming, pose_job);
    Ok(Enqueued::Making(Box::new(upload)))
}

fn accepted(view: CaptureSummary, was_preferred: bool) -> Response {
    let location = format!("/v1/captures/{}", view.id);
    let mut response = (StatusCode::ACCEPTED, [(header::LOCATION, location)], Json(view)).into_response();
    if was_preferred {
        response.headers_mut().insert(APPLIED, HeaderValue::from_static(ASYNC));
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prefer_respond_async_is_parsed_as_in_rfc_7240() {
        let prefers = |values: &[&str]| {
            let pair =
                |value: &&str| (HeaderName::from_static("prefer"), HeaderValue::from_str(value).unwrap());
            let mut headers = HeaderMap::new();
            values.iter().map(pair).for_each(|(name, value)| {
                headers.append(name, value);
            });
            prefers_async(&headers)
        };
        for yes in [&["respond-async"][..], &["wait=5, Respond-Async"], &["wait=5", "respond-async; x=1"]] {
            assert!(prefers(yes), "{yes:?}");
        }
        for no in [&[][..], &["respond-sync"], &["wait=5"], &["x=respond-async"]] {
            assert!(!prefers(no), "{no:?}");
        }
    }
}
