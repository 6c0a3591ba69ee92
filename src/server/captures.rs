//! `/v1/captures`: archives of posed photographs.

use axum::Json;
use axum::extract::{FromRequest, Request, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::api::captures::CaptureSummary;
use crate::api::marks::{Marks, MarksChange};
use crate::api::problem::ContentError;
use crate::api::uploads::FromUpload;
use crate::api::{CaptureId, List, Problem, ResourceKind, ResourceName, TenantId};
use crate::capture::{self, CaptureError, CaptureReport, ImportOptions};
use crate::server::app::Shared;
use crate::server::caller::Caller;
use crate::server::description::{ArchiveForm, File};
use crate::server::extract::{JsonBody, QueryString, UrlPath, media_type};
use crate::server::listing::{rfc3339, unknown_cursor};
use crate::server::marks::{self, MarkedPageQuery, MarksQuery};
use crate::server::upload::{self, Expected};
use crate::server::uploads;
use crate::store::{CaptureRecord, Incoming};

/// The routes of this file that take no archives.
pub(super) fn routes() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(list_captures)).routes(routes!(get_capture, change_capture))
}

/// The routes of this file that take archives.
pub(super) fn uploads() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(upload_capture)).routes(routes!(validate_capture))
}

/// Upload a capture
///
/// A zip, tar or tar.gz, as the raw body, as the multipart field `archive`, or as the complete upload that JSON names (see
/// `/v1/uploads`), which is gone then. It is streamed to disk, hashed and
/// validated; 201 means that every byte is durable. The same content again gives the same capture and 200, called as
/// the last upload calls it.
#[utoipa::path(
    post, path = "/v1/captures", tag = "captures", params(MarksQuery),
    request_body(content(
        (File = "application/zip"), (File = "application/x-tar"), (File = "application/gzip"),
        (ArchiveForm = "multipart/form-data"), (FromUpload = "application/json")
    )),
    responses(
        (status = 201, body = CaptureSummary), (status = 200, body = CaptureSummary, description = "Stored before"),
        (status = 409, body = Problem, description = "The upload is incomplete, or in use"),
        (status = 413, body = Problem), (status = 415, body = Problem),
        (status = 422, body = Problem, description = "Refused; names the file and field"),
        (status = 507, body = Problem, description = "The disk is full; nothing was stored")
    )
)]
async fn upload_capture(
    State(app): State<Shared>,
    caller: Caller,
    QueryString(query): QueryString<MarksQuery>,
    request: Request,
) -> Result<Response, Problem> {
    let marks = query.marks()?;
    let mut incoming = receive(&app, &caller, request).await?;
    if let Some(known) = app.store.capture_by_hash(&caller.tenant, &incoming.sha256).await? {
        match app.store.mend(incoming, &known.artifact).await? {
            None => return Ok(Json(marked(&app, &caller.tenant, known, marks).await?).into_response()),
            // It was deleted meanwhile.
            Some(given_back) => incoming = given_back,
        }
    }
    let report = validate(&app, &incoming).await?;
    let record = CaptureRecord {
        id: app.jobs.fresh_id(),
        sha256: incoming.sha256.clone(),
        bytes: i64::try_from(incoming.bytes).unwrap_or(i64::MAX),
        artifact: format!("captures/{}", incoming.sha256),
        marks: Marks::default(),
        report,
        created_ms: app.jobs.now_ms(),
    };
    let stored = app.store.keep_capture(incoming, &caller.tenant, &record).await?;
    let location = format!("/v1/captures/{}", stored.id);
    let stored = marked(&app, &caller.tenant, stored, marks).await?;
    Ok((StatusCode::CREATED, [(header::LOCATION, location)], Json(stored)).into_response())
}

/// A capture, called what its sender calls it.
async fn marked(
    app: &Shared,
    tenant: &TenantId,
    mut capture: CaptureRecord,
    given: Marks,
) -> Result<CaptureSummary, Problem> {
    let what = ResourceName::new(ResourceKind::Capture, capture.id.to_string());
    capture.marks = marks::mark(app, tenant, what, given, capture.marks).await?;
    Ok(view(capture))
}

/// Validate a capture without storing it
///
/// Takes what an upload takes and answers with the report, or with the problem that an upload would meet.
#[utoipa::path(
    post, path = "/v1/captures/validate", tag = "captures",
    request_body(content(
        (File = "application/zip"), (File = "application/x-tar"), (File = "application/gzip"),
        (ArchiveForm = "multipart/form-data"), (FromUpload = "application/json")
    )),
    responses((status = 200, body = CaptureReport), (status = 422, body = Problem))
)]
async fn validate_capture(
    State(app): State<Shared>,
    caller: Caller,
    request: Request,
) -> Result<Json<CaptureReport>, Problem> {
    let incoming = receive(&app, &caller, request).await?;
    Ok(Json(validate(&app, &incoming).await?))
}

/// List captures
#[utoipa::path(
    get, path = "/v1/captures", tag = "captures", params(MarkedPageQuery),
    responses((status = 200, body = List<CaptureSummary>))
)]
async fn list_captures(
    State(app): State<Shared>,
    caller: Caller,
    QueryString(query): QueryString<MarkedPageQuery>,
) -> Result<Json<List<CaptureSummary>>, Problem> {
    let (page, filter) = query.parts()?;
    let page = page.page()?;
    if let Some(before) = page.before()
        && app.store.capture(&caller.tenant, &before.into()).await?.is_none()
    {
        return Err(unknown_cursor(before));
    }
    let items =
        app.store.captures(&caller.tenant, &filter, &page.of_store()).await?.into_iter().map(view).collect();
    Ok(Json(page.list(items, |c: &CaptureSummary| c.id.as_str())))
}

/// Get a capture
#[utoipa::path(
    get, path = "/v1/captures/{id}", tag = "captures", params(("id" = String, Path)),
    responses((status = 200, body = CaptureSummary), (status = 404, body = Problem))
)]
async fn get_capture(
    State(app): State<Shared>,
    caller: Caller,
    UrlPath(id): UrlPath<CaptureId>,
) -> Result<Json<CaptureSummary>, Problem> {
    find(&app, &caller.tenant, &id).await.map(Json)
}

async fn find(app: &Shared, tenant: &TenantId, id: &CaptureId) -> Result<CaptureSummary, Problem> {
    let record = app.store.capture(tenant, id).await?;
    record.map(view).ok_or_else(|| Problem::not_found("capture", id.as_str()))
}

/// Change what a capture is called
///
/// A JSON merge patch: what is absent stays, what is null goes. One with the label `keep:true` is not deleted by age.
#[utoipa::path(
    patch, path = "/v1/captures/{id}", tag = "captures", params(("id" = String, Path)), request_body = MarksChange,
    responses((status = 200, body = CaptureSummary), (status = 404, body = Problem), (status = 422, body = Problem))
)]
async fn change_capture(
    State(app): State<Shared>,
    caller: Caller,
    UrlPath(id): UrlPath<CaptureId>,
    JsonBody(change): JsonBody<MarksChange>,
) -> Result<Json<CaptureSummary>, Problem> {
    marks::change(&app, &caller.tenant, ResourceKind::Capture, id.as_str(), &change).await?;
    find(&app, &caller.tenant, &id).await.map(Json)
}

async fn receive(app: &Shared, caller: &Caller, request: Request) -> Result<Incoming, Problem> {
    if media_type(request.headers()).as_deref() == Some("application/json") {
        let JsonBody::<FromUpload>(named) = JsonBody::from_request(request, app).await?;
        return uploads::take(app, caller, &named.upload).await;
    }
    const MEDIA_TYPES: &[&str] = &[
        "application/zip",
        "application/x-zip-compressed",
        "application/x-tar",
        "application/gzip",
        "application/x-gzip",
        "application/octet-stream",
    ];
    let expected = Expected { field: "archive", media_types: MEDIA_TYPES, limit: app.limits.capture_bytes };
    upload::receive(app, caller, request, &expected).await
}

/// Decodes everything to see whether it can be decoded.
async fn validate(app: &Shared, incoming: &Incoming) -> Result<CaptureReport, Problem> {
    let path = incoming.path.clone();
    let inspect = move || capture::inspect(&path, &ImportOptions::default());
    app.decoders.run(inspect).await?.map_err(|e| refused(&e, &incoming.path))
}

/// What is wrong with the upload kept at `path`, which the caller knows as the archive.
fn refused(error: &CaptureError, path: &std::path::Path) -> Problem {
    if !error.is_users_fault() {
        return Problem::internal(error);
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

fn view(record: CaptureRecord) -> CaptureSummary {
    CaptureSummary {
        id: record.id,
        sha256: record.sha256,
        bytes: record.bytes,
        marks: record.marks,
        created_at: rfc3339(record.created_ms),
        report: record.report,
    }
}
