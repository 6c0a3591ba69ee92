//! `/v1/captures`: archives of posed photographs.

use axum::Json;
use axum::extract::{FromRequest, Request, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::api::captures::{CaptureState, CaptureSummary};
use crate::api::marks::{Marks, MarksChange};
use crate::api::uploads::CaptureSource;
use crate::api::{CaptureId, List, Problem, ResourceKind, ResourceName, TenantId};
use crate::capture::CaptureReport;
use crate::server::app::Shared;
use crate::server::caller::Caller;
use crate::server::description::{ArchiveForm, File};
use crate::server::extract::{JsonBody, NoQuery, QueryString, UrlPath, media_type};
use crate::server::fetching;
use crate::server::listing::rfc3339;
use crate::server::marks::{self, MarkedPageQuery, MarksQuery};
use crate::server::poses;
use crate::server::upload::{self, Expected};
use crate::server::uploads;
use crate::server::validation::{self, Begun};
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
/// A zip, tar or tar.gz, as the raw body, as the multipart field `archive`, as multipart fields `files` of which each is a file of
/// the capture with its path there as its file name, as the complete upload that JSON names (see
/// `/v1/uploads`), which is gone then, or as the file at the URL that JSON names. It is streamed to disk, hashed and
/// validated; 201 means that every byte is durable. The same content again gives the same capture and 200, called as
/// the last upload calls it. A request that is refused leaves the upload that JSON names as it is. With `Prefer: respond-async`
/// the answer is 202 once every byte is durable: the capture is `validating` then, and `Location` tells when it is `ready` or
/// `invalid`. It is called what the query says from the 202 on; lists have it once it is `ready`.
///
/// Photographs without poses are always answered with 202 where the server finds poses (COLMAP is installed and `--poses` is not off),
/// and refused where it does not: `poses` says how far that is, `/v1/captures/{id}/log` what COLMAP said, `DELETE` ends it. The capture
/// is a tar of the photographs with COLMAP's model; its `made_of` is the hash of what was sent.
#[utoipa::path(
    post, path = "/v1/captures", tag = "captures",
    params(
        MarksQuery,
        ("Prefer" = Option<String>, Header, description = "`respond-async`: do not wait for the validation")
    ),
    request_body(content(
        (File = "application/zip"), (File = "application/x-tar"), (File = "application/gzip"),
        (ArchiveForm = "multipart/form-data"), (CaptureSource = "application/json")
    )),
    responses(
        (status = 201, body = CaptureSummary), (status = 200, body = CaptureSummary, description = "Stored before"),
        (status = 202, body = CaptureSummary, description = "Stored, and being validated"),
        (status = 409, body = Problem, description = "The upload is incomplete, or in use"),
        (status = 413, body = Problem), (status = 415, body = Problem),
        (status = 422, body = Problem, description = "Refused; names the file and field"),
        (status = 502, body = Problem, description = "The file could not be fetched"),
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
    let later = validation::is_preferred(request.headers());
    let mut incoming = receive(&app, &caller, request).await?;
    loop {
        incoming = match known(&app, &caller.tenant, incoming, &marks).await? {
            Known::Stored(capture) => return Ok(Json(view(*capture)).into_response()),
            Known::Not(incoming) => *incoming,
        };
        // Poses take longer than anybody waits for an answer.
        let finds_poses = poses::are_wanted(&app, &incoming).await?;
        if !later && !finds_poses {
            break;
        }
        let how = validation::Later { was_preferred: later, finds_poses };
        match validation::begin(&app, &caller, incoming, marks.clone(), how).await? {
            Begun::Answered(answer) => return Ok(answer),
            Begun::Made(given_back) => incoming = *given_back,
        }
    }
    let stored = validation::make(&app, &caller.tenant, app.jobs.fresh_id(), incoming, marks).await?;
    let location = format!("/v1/captures/{}", stored.id);
    Ok((StatusCode::CREATED, [(header::LOCATION, location)], Json(view(stored))).into_response())
}

/// Whether there is a capture of some content.
enum Known {
    Stored(Box<CaptureRecord>),
    Not(Box<Incoming>),
}

/// The capture of a tenant that has this content or was made of it, called what its sender calls it.
async fn known(
    app: &Shared,
    tenant: &TenantId,
    mut incoming: Incoming,
    marks: &Marks,
) -> Result<Known, Problem> {
    if let Some(same) = app.store.capture_by_hash(tenant, &incoming.sha256).await? {
        // Before the upload is taken: it stays when the capture may not be called so.
        let same = marked(app, tenant, same, marks.clone()).await?;
        match app.store.mend(incoming, &same.artifact).await? {
            None => return Ok(Known::Stored(Box::new(same))),
            // It was deleted meanwhile.
            Some(given_back) => incoming = given_back,
        }
    }
    if let Some(same) = app.store.capture_made_of(tenant, &incoming.sha256).await? {
        let same = marked(app, tenant, same, marks.clone()).await?;
        app.store.forget_pieces(incoming).await?;
        return Ok(Known::Stored(Box::new(same)));
    }
    Ok(Known::Not(Box::new(incoming)))
}

/// A capture that is known, called what its sender calls it.
async fn marked(
    app: &Shared,
    tenant: &TenantId,
    mut capture: CaptureRecord,
    given: Marks,
) -> Result<CaptureRecord, Problem> {
    let what = ResourceName::new(ResourceKind::Capture, capture.id.to_string());
    capture.marks = marks::mark(app, tenant, what, given, capture.marks).await?;
    Ok(capture)
}

/// Validate a capture without storing it
///
/// Takes what an upload takes and answers with the report, or with the problem that an upload would meet.
#[utoipa::path(
    post, path = "/v1/captures/validate", tag = "captures",
    request_body(content(
        (File = "application/zip"), (File = "application/x-tar"), (File = "application/gzip"),
        (ArchiveForm = "multipart/form-data"), (CaptureSource = "application/json")
    )),
    responses(
        (status = 200, body = CaptureReport), (status = 422, body = Problem),
        (status = 502, body = Problem, description = "The file could not be fetched")
    )
)]
async fn validate_capture(
    State(app): State<Shared>,
    caller: Caller,
    _: QueryString<NoQuery>,
    request: Request,
) -> Result<Json<CaptureReport>, Problem> {
    let incoming = receive(&app, &caller, request).await?;
    Ok(Json(validation::validate(&app, &incoming).await?))
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
    let page = page.page(async |id| app.store.capture(&caller.tenant, &id.into()).await).await?;
    Ok(Json(page.list(app.store.captures(&caller.tenant, &filter, &page.of_store()).await?, view)))
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

/// A capture, also one that is being made or could not be.
async fn find(app: &Shared, tenant: &TenantId, id: &CaptureId) -> Result<CaptureSummary, Problem> {
    // What is being made is asked for first: it becomes a capture, never the other way.
    let upload = app.store.upload_for(tenant, id).await?;
    match (app.store.capture(tenant, id).await?, upload) {
        (Some(record), _) => Ok(view(record)),
        (None, Some(upload)) => Ok(validation::view(app, &upload)),
        (None, None) => Err(Problem::not_found("capture", id.as_str())),
    }
}

/// Change what a capture is called
///
/// A JSON merge patch: what is absent stays, what is null goes. One that is `validating` is called so when it is `ready`. One with
/// the label `keep:true` is not deleted by age.
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
    let expected = Expected {
        field: "archive",
        media_types: MEDIA_TYPES,
        takes_files: true,
        limit: app.limits.capture_bytes,
    };
    upload::receive(app, caller, request, &expected).await
}

/// The bytes that a body names.
async fn from_source(app: &Shared, caller: &Caller, source: &CaptureSource) -> Result<Incoming, Problem> {
    let is_hash = |text: &str| text.len() == 64 && text.bytes().all(|byte| byte.is_ascii_hexdigit());
    if source.sha256.as_deref().is_some_and(|text| !is_hash(text)) {
        return Err(Problem::invalid_field("/sha256", "must be 64 hexadecimal digits"));
    }
    let incoming = match (&source.upload, &source.url) {
        (Some(upload), None) => uploads::take(app, caller, upload).await?,
        (None, Some(url)) => fetching::receive(app, caller, url, app.limits.capture_bytes).await?,
        (None, None) => return Err(Problem::invalid_field("/upload", "name an upload or a url")),
        (Some(_), Some(_)) => {
            return Err(Problem::invalid_field("/url", "name an upload or a url, not both"));
        }
    };
    match &source.sha256 {
        Some(sha256) if !sha256.eq_ignore_ascii_case(&incoming.sha256) => {
            let found = format!("that of the file is {}", incoming.sha256);
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
        marks: record.marks,
        created_at: rfc3339(record.created_ms),
        state: CaptureState::Ready,
        problem: None,
        upload: None,
        poses: None,
        made_of: record.made_of,
        report: record.report,
    }
}
