//! `/v1/captures`: archives of posed photographs.

use axum::Json;
use axum::extract::{FromRequest, Request, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::capture_creation::{self, AsyncOutcome, CaptureLookup};
use crate::server::description::{ArchiveForm, File};
use crate::server::extract::{JsonBody, NoQuery, QueryString, UrlPath, media_type};
use crate::server::file_body::{self, AcceptedBody};
use crate::server::listing::rfc3339;
use crate::server::metadata::{self, FilteredPageQuery, MetadataQuery};
use crate::server::problem::Problem;
use crate::server::{fetching, poses, sample_capture, uploads};
use crate::store::{CaptureRecord, StagedUpload};
use relume_api::captures::{CaptureState, CaptureSummary};
use relume_api::metadata::MetadataChange;
use relume_api::uploads::CaptureSource;
use relume_api::{CaptureId, List, ResourceKind, TenantId};
use relume_spec::CaptureReport;

/// The routes of this file that accept no archives.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(list_captures)).routes(routes!(get_capture, change_capture))
}

/// The routes of this file that accept archives.
pub(super) fn uploads() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(upload_capture)).routes(routes!(validate_capture))
}

/// Create a capture
///
/// Accepts a zip, tar or tar.gz in one of these forms:
///
/// - the raw body
/// - the multipart field `archive`
/// - multipart fields `files`, one per file of the capture, with the path in the capture as the file name
/// - JSON with `upload`, a complete upload (see `/v1/uploads`); the server deletes the upload after success
///   and keeps it after an error
/// - JSON with `url`, a file that the server fetches
/// - JSON with `"sample": true`, a small synthetic capture that the server renders
///
/// The server streams the file to disk, hashes and validates it. It answers 201 when every byte is durable.
/// If the tenant already has a capture with the same content, the server answers 200 with that capture and
/// gives it the name, external identifier and labels of the query.
///
/// With `Prefer: respond-async` the server answers 202 when every byte is durable, before the validation. The
/// capture then has the state `validating` and the name from the query. `GET` on the `Location` returns the
/// state `ready` or `invalid` after the validation. Lists contain the capture when it is `ready`.
///
/// For photographs without poses, the server finds the poses with COLMAP and always answers 202. It refuses
/// such photographs if COLMAP is not installed or the server runs with `--poses off`. The field `poses` has
/// the progress, `GET /v1/captures/{id}/log` returns the output of COLMAP, and `DELETE` cancels the work. The
/// resulting capture is a tar of the photographs with COLMAP's model, and `made_of` is the hash of the
/// uploaded file.
#[utoipa::path(
    post, path = "/v1/captures", tag = "captures",
    params(
        MetadataQuery,
        ("Prefer" = Option<String>, Header, description = "`respond-async`: answer before the validation")
    ),
    request_body(content(
        (File = "application/zip"), (File = "application/x-tar"), (File = "application/gzip"),
        (ArchiveForm = "multipart/form-data"), (CaptureSource = "application/json")
    )),
    responses(
        (status = 201, body = CaptureSummary), (status = 200, body = CaptureSummary, description = "Already stored"),
        (status = 202, body = CaptureSummary, description = "Stored; the validation runs"),
        (status = 409, body = Problem, description = "The upload is incomplete or in use"),
        (status = 413, body = Problem), (status = 415, body = Problem),
        (status = 422, body = Problem, description = "Invalid content; `content` names the file and the field"),
        (status = 502, body = Problem, description = "The server could not fetch the file"),
        (status = 507, body = Problem, description = "The disk is full; the server stored nothing")
    )
)]
async fn upload_capture(
    State(app): State<AppState>,
    caller: Caller,
    QueryString(query): QueryString<MetadataQuery>,
    request: Request,
) -> Result<Response, Problem> {
    let metadata = query.metadata()?;
    let later = capture_creation::prefers_async(request.headers());
    let mut incoming = receive(&app, &caller, request).await?;
    loop {
        incoming = match capture_creation::look_up(&app, &caller.tenant, incoming, &metadata).await? {
            CaptureLookup::Existing(capture) => return Ok(Json(view(*capture)).into_response()),
            CaptureLookup::New(incoming) => *incoming,
        };
        // Pose estimation takes too long for a synchronous answer.
        let finds_poses = poses::needs_poses(&app, &caller.tenant, &incoming).await?;
        if !later && !finds_poses {
            break;
        }
        let how = capture_creation::AsyncOptions { was_preferred: later, finds_poses };
        match capture_creation::begin(&app, &caller, incoming, metadata.clone(), how).await? {
            AsyncOutcome::Answered(answer) => return Ok(answer),
            AsyncOutcome::Made(given_back) => incoming = *given_back,
        }
    }
    let stored =
        capture_creation::create(&app, &caller.tenant, app.jobs.fresh_id(), incoming, metadata).await?;
    let location = format!("/v1/captures/{}", stored.id);
    Ok((StatusCode::CREATED, [(header::LOCATION, location)], Json(view(stored))).into_response())
}

/// Validate a capture without storing it
///
/// Accepts the same bodies as `POST /v1/captures`. Returns the report of the validation, or the problem that
/// `POST /v1/captures` would return.
#[utoipa::path(
    post, path = "/v1/captures/validate", tag = "captures",
    request_body(content(
        (File = "application/zip"), (File = "application/x-tar"), (File = "application/gzip"),
        (ArchiveForm = "multipart/form-data"), (CaptureSource = "application/json")
    )),
    responses(
        (status = 200, body = CaptureReport), (status = 422, body = Problem),
        (status = 502, body = Problem, description = "The server could not fetch the file")
    )
)]
async fn validate_capture(
    State(app): State<AppState>,
    caller: Caller,
    _: QueryString<NoQuery>,
    request: Request,
) -> Result<Json<CaptureReport>, Problem> {
    let incoming = receive(&app, &caller, request).await?;
    Ok(Json(capture_creation::validate(&app, &caller.tenant, &incoming).await?))
}

/// List captures
///
/// Returns the captures of the caller's tenant in the state `ready`, newest first.
#[utoipa::path(
    get, path = "/v1/captures", tag = "captures", params(FilteredPageQuery),
    responses((status = 200, body = List<CaptureSummary>))
)]
async fn list_captures(
    State(app): State<AppState>,
    caller: Caller,
    QueryString(query): QueryString<FilteredPageQuery>,
) -> Result<Json<List<CaptureSummary>>, Problem> {
    let (page, filter) = query.parts()?;
    let page = page.page(async |id| app.store.capture(&caller.tenant, &id.into()).await).await?;
    Ok(Json(page.list(app.store.captures(&caller.tenant, &filter, &page.store_page()).await?, view)))
}

/// Get a capture
///
/// Returns a capture in any state, with the report of its validation.
#[utoipa::path(
    get, path = "/v1/captures/{id}", tag = "captures",
    params(("id" = String, Path, description = "Capture identifier")),
    responses((status = 200, body = CaptureSummary), (status = 404, body = Problem))
)]
async fn get_capture(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<CaptureId>,
) -> Result<Json<CaptureSummary>, Problem> {
    find(&app, &caller.tenant, &id).await.map(Json)
}

/// A capture in any state.
async fn find(app: &AppState, tenant: &TenantId, id: &CaptureId) -> Result<CaptureSummary, Problem> {
    // The upload is queried first, because an upload can become a capture but not the reverse.
    let upload = app.store.upload_of_capture(tenant, id).await?;
    match (app.store.capture(tenant, id).await?, upload) {
        (Some(record), _) => Ok(view(record)),
        (None, Some(upload)) => Ok(capture_creation::view(app, &upload)),
        (None, None) => Err(Problem::not_found("capture", id.as_str())),
    }
}

/// Change the metadata of a capture
///
/// A JSON merge patch (RFC 7396) of name, external identifier and labels. Omitted fields are unchanged; null
/// clears a field. A capture in the state `validating` keeps the change when it becomes `ready`. The server
/// does not delete a capture with the label `keep:true` because of its age.
#[utoipa::path(
    patch, path = "/v1/captures/{id}", tag = "captures",
    params(("id" = String, Path, description = "Capture identifier")),
    request_body = MetadataChange,
    responses((status = 200, body = CaptureSummary), (status = 404, body = Problem), (status = 422, body = Problem))
)]
async fn change_capture(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<CaptureId>,
    JsonBody(change): JsonBody<MetadataChange>,
) -> Result<Json<CaptureSummary>, Problem> {
    metadata::change(&app, &caller.tenant, ResourceKind::Capture, id.as_str(), &change).await?;
    find(&app, &caller.tenant, &id).await.map(Json)
}

async fn receive(app: &AppState, caller: &Caller, request: Request) -> Result<StagedUpload, Problem> {
    if media_type(request.headers()).as_deref() == Some("application/json") {
        let JsonBody::<CaptureSource>(source) = JsonBody::from_request(request, app).await?;
        return from_source(app, caller, &source).await;
    }
    const MEDIA_TYPES: &[&str] = &[
        "application/zip",
        "application/x-zip-compressed",
        "application/x-tar",
        "application/gzip",
        "application/x-gzip",
        "application/octet-stream",
    ];
    let expected = AcceptedBody {
        field: "archive",
        media_types: MEDIA_TYPES,
        takes_files: true,
        limit: app.limits.capture_bytes,
    };
    file_body::receive(app, caller, request, &expected).await
}

/// The bytes of the source in a body.
async fn from_source(
    app: &AppState,
    caller: &Caller,
    source: &CaptureSource,
) -> Result<StagedUpload, Problem> {
    let is_hash = |text: &str| text.len() == 64 && text.bytes().all(|byte| byte.is_ascii_hexdigit());
    if source.sha256.as_deref().is_some_and(|text| !is_hash(text)) {
        return Err(Problem::invalid_field("/sha256", "must be 64 hexadecimal digits"));
    }
    let incoming = match (&source.upload, &source.url, source.sample) {
        (Some(upload), None, false) => uploads::finalise(app, caller, upload).await?,
        (None, Some(url), false) => fetching::receive(app, caller, url, app.limits.capture_bytes).await?,
        (None, None, true) => sample_capture::receive(app, caller).await?,
        (None, None, false) => {
            return Err(Problem::invalid_field("/upload", "one of upload, url and sample is required"));
        }
        (Some(_), Some(_), _) => {
            return Err(Problem::invalid_field("/url", "must not be combined with upload"));
        }
        (_, _, true) => {
            return Err(Problem::invalid_field("/sample", "must not be combined with upload or url"));
        }
    };
    match &source.sha256 {
        Some(sha256) if !sha256.eq_ignore_ascii_case(&incoming.sha256) => {
            let found = format!("does not match the file, whose SHA-256 is {}", incoming.sha256);
            Err(Problem::invalid_field("/sha256", found))
        }
        _ => Ok(incoming),
    }
}

fn view(record: CaptureRecord) -> CaptureSummary {
    CaptureSummary {
        id: record.id,
        sha256: record.sha256,
        bytes: record.bytes,
        metadata: record.metadata,
        created_at: rfc3339(record.created_ms),
        state: CaptureState::Ready,
        problem: None,
        upload: None,
        poses: None,
        made_of: record.made_of,
        report: record.report,
    }
}
