//! Makes captures of complete uploads, synchronously or after a 202 answer (RFC 7240, `respond-async`).

use std::time::Duration;

use axum::Json;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use tokio::sync::Mutex;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::listing::rfc3339;
use crate::server::metadata;
use crate::server::poses::{self, PoseJob};
use crate::server::problem::Problem;
use crate::server::uploads;
use crate::store::{CaptureRecord, StagedUpload, StoreError, UploadRecord};
use relume_api::captures::{CaptureState, CaptureSummary};
use relume_api::metadata::ResourceMetadata;
use relume_api::problem::{ContentError, TYPE_PREFIX};
use relume_api::{CaptureId, ResourceKind, ResourceName, TenantId};
use relume_capture::{self, CaptureError, ImportOptions};
use relume_spec::CaptureReport;

const APPLIED: HeaderName = HeaderName::from_static("preference-applied");
const ASYNC: &str = "respond-async";
/// Delay between retries while the object store cannot be reached.
const RETRY_INTERVAL: Duration = Duration::from_secs(2);
/// Serialises requests, so that those with the same content detect each other.
static ENQUEUE_LOCK: Mutex<()> = Mutex::const_new(());

/// Whether the caller prefers an asynchronous answer.
pub(super) fn prefers_async(headers: &HeaderMap) -> bool {
    let values = headers.get_all("prefer").iter().filter_map(|value| value.to_str().ok());
    let mut preferences = values.flat_map(|value| value.split(','));
    preferences.any(|p| p.split(';').next().unwrap_or_default().trim().eq_ignore_ascii_case(ASYNC))
}

/// Decodes the whole capture to check that it is valid.
pub(super) async fn validate(app: &AppState, incoming: &StagedUpload) -> Result<CaptureReport, Problem> {
    let path = incoming.path.clone();
    let options = ImportOptions { limits: app.import_limits, ..ImportOptions::default() };
    let inspect = move || relume_capture::inspect(&path, &options);
    let error = match app.decoders.run(inspect).await? {
        Ok(report) => return Ok(report),
        Err(error) => error,
    };
    let mut problem = refused(&error, &incoming.path);
    if matches!(error, CaptureError::UnknownLayout { .. })
        && let Some(reason) = poses::refusal(app, incoming).await?
    {
        problem.detail = problem.detail.take().map(|detail| format!("{detail}; {reason}"));
    }
    Err(problem)
}

/// Makes the capture `id` of a tenant of photographs without poses.
async fn make_with_poses(
    app: &AppState,
    tenant: &TenantId,
    id: CaptureId,
    photographs: StagedUpload,
    pose_job: PoseJob,
) -> Result<CaptureRecord, Problem> {
    let made_of = photographs.sha256.clone();
    let posed = poses::find(app, tenant, &id, photographs, pose_job).await?;
    make_record(app, tenant, id, posed, ResourceMetadata::default(), Some(made_of)).await
}

/// Makes the capture `id` of a tenant with these metadata, or returns the tenant's existing capture of the same content.
pub(super) async fn make(
    app: &AppState,
    tenant: &TenantId,
    id: CaptureId,
    incoming: StagedUpload,
    metadata: ResourceMetadata,
) -> Result<CaptureRecord, Problem> {
    make_record(app, tenant, id, incoming, metadata, None).await
}

async fn make_record(
    app: &AppState,
    tenant: &TenantId,
    id: CaptureId,
    incoming: StagedUpload,
    metadata: ResourceMetadata,
    made_of: Option<String>,
) -> Result<CaptureRecord, Problem> {
    let report = validate(app, &incoming).await?;
    let record = CaptureRecord {
        id,
        sha256: incoming.sha256.clone(),
        bytes: i64::try_from(incoming.bytes).unwrap_or(i64::MAX),
        artifact: format!("captures/{}", incoming.sha256),
        metadata,
        report,
        created_ms: app.jobs.now_ms(),
        made_of,
    };
    app.store.publish_capture(incoming, tenant, &record).await.map_err(metadata::refused)
}

/// Options of an asynchronous creation.
#[derive(Debug, Clone, Copy)]
pub(super) struct AsyncOptions {
    /// Whether the caller prefers an asynchronous answer.
    pub(super) was_preferred: bool,
    /// Whether the photographs have no poses, so that these are found first.
    pub(super) finds_poses: bool,
}

/// The result of a request for an asynchronous creation.
pub(super) enum AsyncOutcome {
    /// A capture is being made; this is the answer with its URL.
    Answered(Response),
    /// The same content has become a capture in the meantime; nothing is made of the upload.
    Made(Box<StagedUpload>),
}

/// Starts the creation of a capture and answers with its URL. If a capture of the same content is already being made, the answer
/// has that URL.
pub(super) async fn begin(
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
        Enqueued::Making(upload) => AsyncOutcome::Answered(accepted(view(&app, &upload), how.was_preferred)),
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
    if capture_of(app, &tenant, &incoming).await?.is_some() {
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
    start(app, tenant, capture, incoming, pose_job);
    Ok(Enqueued::Making(Box::new(upload)))
}

/// Continues the creations of a terminated server.
pub(super) async fn resume(app: AppState) -> Result<(), StoreError> {
    for upload in app.store.pending_validations().await? {
        let (Some(capture), Some(lock)) = (upload.capture_id.clone(), app.store.lock_upload(&upload.id))
        else {
            continue;
        };
        let name: String = app.jobs.fresh_id();
        let incoming = app.store.finalise_upload(lock, &upload, &name).await?;
        start(&app, upload.tenant, capture, incoming, None);
    }
    Ok(())
}

/// Makes a capture in the background. A shutdown leaves it to the next server.
fn start(
    app: &AppState,
    tenant: TenantId,
    capture: CaptureId,
    incoming: StagedUpload,
    pose_job: Option<PoseJob>,
) {
    let app = app.clone();
    tokio::spawn(async move {
        tokio::select! {
            () = app.stop.cancelled() => {}
            () = finish(&app, &tenant, capture, incoming, pose_job) => {}
        }
    });
}

async fn finish(
    app: &AppState,
    tenant: &TenantId,
    capture: CaptureId,
    incoming: StagedUpload,
    pose_job: Option<PoseJob>,
) {
    let mut made = try_finish(app, tenant, &capture, incoming, pose_job).await;
    while made.as_ref().is_err_and(is_outage) && !app.stop.is_cancelled() {
        tokio::time::sleep(RETRY_INTERVAL).await;
        made = match reopen_upload(app, tenant, &capture).await {
            Ok(Some(incoming)) => try_finish(app, tenant, &capture, incoming, None).await,
            // The upload was deleted.
            Ok(None) => return,
            Err(error) => Err(error.into()),
        };
    }
    if app.stop.is_cancelled() {
        // The next server continues.
        return;
    }
    poses::clean_up(&app.store, &capture, made.is_err()).await;
    if let Err(problem) = made {
        tracing::info!(%capture, kind = problem.kind, "no capture could be made of an upload");
        let until = uploads::expiry(app);
        if let Err(error) = app.store.end_validation(&capture, &problem, until).await {
            tracing::error!(%error, %capture, "cannot record the end of a validation; the next start validates the upload again");
        }
    }
}

/// Whether a problem is an outage of the object store, so that the creation must be retried.
fn is_outage(problem: &Problem) -> bool {
    problem.kind.strip_prefix(TYPE_PREFIX) == Some("artifacts-unreachable")
}

/// The bytes of the upload of a capture that is being made, again; `None` if the upload no longer exists.
async fn reopen_upload(
    app: &AppState,
    tenant: &TenantId,
    capture: &CaptureId,
) -> Result<Option<StagedUpload>, StoreError> {
    let Some(upload) = app.store.upload_of_capture(tenant, capture).await? else { return Ok(None) };
    let Some(lock) = app.store.lock_upload(&upload.id) else { return Ok(None) };
    let name: String = app.jobs.fresh_id();
    app.store.finalise_upload(lock, &upload, &name).await.map(Some)
}

async fn try_finish(
    app: &AppState,
    tenant: &TenantId,
    capture: &CaptureId,
    incoming: StagedUpload,
    mut pose_job: Option<PoseJob>,
) -> Result<(), Problem> {
    // Another request made the capture in the meantime.
    if let Some(same) = capture_of(app, tenant, &incoming).await? {
        return Err(duplicate_capture(&same));
    }
    // The current metadata are recorded with the upload.
    if pose_job.is_none() && poses::needs_poses(app, &incoming).await? {
        pose_job = Some(app.poses.enqueue(capture));
    }
    let made = match pose_job {
        Some(pose_job) => make_with_poses(app, tenant, capture.clone(), incoming, pose_job).await?,
        None => make(app, tenant, capture.clone(), incoming, ResourceMetadata::default()).await?,
    };
    if made.id == *capture { Ok(()) } else { Err(duplicate_capture(&made)) }
}

/// The capture of a tenant with this content or made of it.
async fn capture_of(
    app: &AppState,
    tenant: &TenantId,
    incoming: &StagedUpload,
) -> Result<Option<CaptureRecord>, StoreError> {
    match app.store.capture_by_hash(tenant, &incoming.sha256).await? {
        Some(same) => Ok(Some(same)),
        None => app.store.capture_made_of(tenant, &incoming.sha256).await,
    }
}

fn duplicate_capture(same: &CaptureRecord) -> Problem {
    Problem::conflict("stored-before", format!("the capture {:?} has the same content", same.id.as_str()))
}

/// The problem of a job whose capture `id` is not ready.
pub(super) async fn unavailable_reason(
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

fn accepted(view: CaptureSummary, was_preferred: bool) -> Response {
    let location = format!("/v1/captures/{}", view.id);
    let mut response = (StatusCode::ACCEPTED, [(header::LOCATION, location)], Json(view)).into_response();
    if was_preferred {
        response.headers_mut().insert(APPLIED, HeaderValue::from_static(ASYNC));
    }
    response
}

/// The view of a capture that is being made or is invalid.
pub(super) fn view(app: &AppState, upload: &UploadRecord) -> CaptureSummary {
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

/// The problem of the upload at `path`, with the name that the client knows instead of the path.
fn refused(error: &CaptureError, path: &std::path::Path) -> Problem {
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
