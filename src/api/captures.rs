//! `/v1/captures`: archives of posed photographs.

use axum::Json;
use axum::extract::{Path, Request, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::api::description::{ArchiveForm, File};
use crate::api::extract::QueryString;
use crate::api::listing::{List, PageQuery, rfc3339};
use crate::api::problem::ContentError;
use crate::api::upload::{self, Expected};
use crate::api::{Problem, Shared};
pub use crate::capture::CaptureReport;
use crate::capture::{self, CaptureError, ImportOptions};
use crate::store::{CaptureRecord, Incoming};

/// The routes of this family.
pub(super) fn routes() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .routes(routes!(upload_capture, list_captures))
        .routes(routes!(validate_capture))
        .routes(routes!(get_capture))
}

/// An accepted capture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CaptureView {
    /// Identifier.
    pub id: String,
    /// Hash of the archive, lower-case hex.
    pub sha256: String,
    /// Size of the archive.
    pub bytes: i64,
    /// RFC 3339.
    pub created_at: String,
    /// What validation found.
    pub report: CaptureReport,
}

/// Upload a capture
///
/// A zip, tar or tar.gz, as the raw body or as the multipart field `archive`. It is streamed to disk, hashed and
/// validated; 201 means that every byte is durable. The same content again gives the same capture and 200.
#[utoipa::path(
    post, path = "/v1/captures", tag = "captures",
    request_body(content(
        (File = "application/zip"), (File = "application/x-tar"), (File = "application/gzip"),
        (ArchiveForm = "multipart/form-data")
    )),
    responses(
        (status = 201, body = CaptureView), (status = 200, body = CaptureView, description = "Known already"),
        (status = 413, body = Problem), (status = 415, body = Problem),
        (status = 422, body = Problem, description = "Refused; names the file and field"),
        (status = 507, body = Problem, description = "No room; nothing was stored")
    )
)]
async fn upload_capture(State(app): State<Shared>, request: Request) -> Result<Response, Problem> {
    let incoming = receive(&app, request).await?;
    if let Some(known) = app.store.capture_by_hash(&incoming.sha256).await? {
        return Ok(Json(view(&known)?).into_response());
    }
    let report = validate(&app, &incoming).await?;
    let record = CaptureRecord {
        id: app.jobs.fresh_id(),
        sha256: incoming.sha256.clone(),
        bytes: i64::try_from(incoming.bytes).unwrap_or(i64::MAX),
        artifact: format!("captures/{}", incoming.sha256),
        report: serde_json::to_string(&report).map_err(Problem::internal)?,
        created_ms: app.jobs.now_ms(),
    };
    app.store.artifacts().publish(incoming, &record.artifact).await?;
    let stored = app.store.insert_capture(&record).await?;
    let mut response = (StatusCode::CREATED, Json(view(&stored)?)).into_response();
    if let Ok(location) = HeaderValue::from_str(&format!("/v1/captures/{}", stored.id)) {
        response.headers_mut().insert(header::LOCATION, location);
    }
    Ok(response)
}

/// Validate a capture without keeping it
///
/// Takes what an upload takes and answers with the report, or with the problem that an upload would meet.
#[utoipa::path(
    post, path = "/v1/captures/validate", tag = "captures",
    request_body(content(
        (File = "application/zip"), (File = "application/x-tar"), (File = "application/gzip"),
        (ArchiveForm = "multipart/form-data")
    )),
    responses((status = 200, body = CaptureReport), (status = 422, body = Problem))
)]
async fn validate_capture(
    State(app): State<Shared>,
    request: Request,
) -> Result<Json<CaptureReport>, Problem> {
    let incoming = receive(&app, request).await?;
    Ok(Json(validate(&app, &incoming).await?))
}

/// List captures
#[utoipa::path(
    get, path = "/v1/captures", tag = "captures", params(PageQuery),
    responses((status = 200, body = List<CaptureView>))
)]
async fn list_captures(
    State(app): State<Shared>,
    QueryString(query): QueryString<PageQuery>,
) -> Result<Json<List<CaptureView>>, Problem> {
    let page = query.page()?;
    let records = app.store.captures(&page).await?;
    let items = records.iter().map(view).collect::<Result<_, _>>()?;
    Ok(Json(List::new(items, &page, |c: &CaptureView| &c.id)))
}

/// Look at a capture
#[utoipa::path(
    get, path = "/v1/captures/{id}", tag = "captures", params(("id" = String, Path)),
    responses((status = 200, body = CaptureView), (status = 404, body = Problem))
)]
async fn get_capture(
    State(app): State<Shared>,
    Path(id): Path<String>,
) -> Result<Json<CaptureView>, Problem> {
    let record = app.store.capture(&id).await?;
    Ok(Json(view(&record.ok_or_else(|| Problem::not_found("capture", &id))?)?))
}

async fn receive(app: &Shared, request: Request) -> Result<Incoming, Problem> {
    const MEDIA_TYPES: &[&str] = &[
        "application/zip",
        "application/x-zip-compressed",
        "application/x-tar",
        "application/gzip",
        "application/x-gzip",
        "application/octet-stream",
    ];
    let expected = Expected { field: "archive", media_types: MEDIA_TYPES, limit: app.limits.capture_bytes };
    upload::receive(app, request, &expected).await
}

/// Decodes everything to see whether it can be; a few at a time, since images take memory.
async fn validate(app: &Shared, incoming: &Incoming) -> Result<CaptureReport, Problem> {
    let _turn = app.imports.acquire().await.map_err(Problem::internal)?;
    let path = incoming.path.clone();
    let inspect = move || capture::inspect(&path, &ImportOptions::default());
    tokio::task::spawn_blocking(inspect).await.map_err(Problem::internal)?.map_err(refused)
}

fn refused(error: CaptureError) -> Problem {
    if !error.is_users_fault() {
        return Problem::internal(error);
    }
    let content = ContentError {
        code: error.code().to_owned(),
        file: error.file().map(str::to_owned),
        field: error.field().map(str::to_owned),
    };
    Problem::invalid_content(content, error.to_string())
}

fn view(record: &CaptureRecord) -> Result<CaptureView, Problem> {
    Ok(CaptureView {
        id: record.id.clone(),
        sha256: record.sha256.clone(),
        bytes: record.bytes,
        created_at: rfc3339(record.created_ms),
        report: serde_json::from_str(&record.report).map_err(Problem::internal)?,
    })
}
