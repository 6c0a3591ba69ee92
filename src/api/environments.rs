//! `/v1/environments`: HDR environment maps.

use axum::Json;
use axum::extract::{Path, Request, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::api::description::{EnvironmentForm, File};
use crate::api::extract::QueryString;
use crate::api::listing::{List, PageQuery, rfc3339};
use crate::api::problem::ContentError;
use crate::api::upload::{self, Expected};
use crate::api::{Problem, Shared};
use crate::capture::BUILTIN;
use crate::formats::environment::{self, LoadedEnvironment};
use crate::store::{EnvironmentRecord, Incoming};

/// The routes of this family.
pub(super) fn routes() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .routes(routes!(upload_environment, list_environments))
        .routes(routes!(get_environment))
}

/// An accepted environment map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct EnvironmentView {
    /// Identifier.
    pub id: String,
    /// The uploader's name for it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub name: Option<String>,
    /// Hash of the file, lower-case hex.
    pub sha256: String,
    /// Size of the file.
    pub bytes: i64,
    /// Columns.
    pub width: i64,
    /// Rows.
    pub height: i64,
    /// What was mended, e.g. negative values set to 0.
    pub warnings: Vec<String>,
    /// RFC 3339.
    pub created_at: String,
}

/// Environment maps: those that come with the program, and a page of the uploaded ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct EnvironmentList {
    /// Names of the built-in maps.
    pub builtin: Vec<String>,
    /// Uploaded maps, newest first.
    #[serde(flatten)]
    pub uploaded: List<EnvironmentView>,
}

/// How to file an uploaded map.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct UploadQuery {
    /// A name for people, at most 128 characters.
    name: Option<String>,
}

/// Upload an environment map
///
/// An equirectangular Radiance `.hdr` or OpenEXR, as the raw body or as the multipart field `environment`. Row 0
/// looks along world +Z. NaN and infinity are refused; negative values are set to 0 with a warning.
#[utoipa::path(
    post, path = "/v1/environments", tag = "environments", params(UploadQuery),
    request_body(content(
        (File = "image/vnd.radiance"), (File = "image/x-exr"), (EnvironmentForm = "multipart/form-data")
    )),
    responses(
        (status = 201, body = EnvironmentView),
        (status = 200, body = EnvironmentView, description = "Known already"),
        (status = 413, body = Problem), (status = 415, body = Problem), (status = 422, body = Problem)
    )
)]
async fn upload_environment(
    State(app): State<Shared>,
    QueryString(query): QueryString<UploadQuery>,
    request: Request,
) -> Result<Response, Problem> {
    if query.name.as_ref().is_some_and(|n| n.is_empty() || n.chars().count() > 128) {
        return Err(Problem::invalid_field("query/name", "must have 1 to 128 characters"));
    }
    let incoming = receive(&app, request).await?;
    if let Some(known) = app.store.environment_by_hash(&incoming.sha256).await? {
        return Ok(Json(view(&known)?).into_response());
    }
    let (width, height, warnings) = validate(&app, &incoming).await?;
    let record = EnvironmentRecord {
        id: app.jobs.fresh_id(),
        sha256: incoming.sha256.clone(),
        name: query.name,
        bytes: i64::try_from(incoming.bytes).unwrap_or(i64::MAX),
        artifact: format!("environments/{}", incoming.sha256),
        width,
        height,
        warnings: serde_json::to_string(&warnings).map_err(Problem::internal)?,
        created_ms: app.jobs.now_ms(),
    };
    app.store.artifacts().publish(incoming, &record.artifact).await?;
    let stored = app.store.insert_environment(&record).await?;
    Ok((StatusCode::CREATED, Json(view(&stored)?)).into_response())
}

/// List environment maps
#[utoipa::path(
    get, path = "/v1/environments", tag = "environments", params(PageQuery),
    responses((status = 200, body = EnvironmentList))
)]
async fn list_environments(
    State(app): State<Shared>,
    QueryString(query): QueryString<PageQuery>,
) -> Result<Json<EnvironmentList>, Problem> {
    let page = query.page()?;
    let records = app.store.environments(&page).await?;
    let items = records.iter().map(view).collect::<Result<_, _>>()?;
    Ok(Json(EnvironmentList {
        builtin: BUILTIN.iter().map(|&name| name.to_owned()).collect(),
        uploaded: List::new(items, &page, |e: &EnvironmentView| &e.id),
    }))
}

/// Look at an environment map
#[utoipa::path(
    get, path = "/v1/environments/{id}", tag = "environments", params(("id" = String, Path)),
    responses((status = 200, body = EnvironmentView), (status = 404, body = Problem))
)]
async fn get_environment(
    State(app): State<Shared>,
    Path(id): Path<String>,
) -> Result<Json<EnvironmentView>, Problem> {
    let record = app.store.environment(&id).await?;
    Ok(Json(view(&record.ok_or_else(|| Problem::not_found("environment", &id))?)?))
}

async fn receive(app: &Shared, request: Request) -> Result<Incoming, Problem> {
    const MEDIA_TYPES: &[&str] =
        &["image/vnd.radiance", "image/x-hdr", "image/x-exr", "image/aces", "application/octet-stream"];
    let limit = app.limits.environment_bytes;
    let expected = Expected { field: "environment", media_types: MEDIA_TYPES, limit };
    upload::receive(app, request, &expected).await
}

async fn validate(app: &Shared, incoming: &Incoming) -> Result<(i64, i64, Vec<String>), Problem> {
    let _turn = app.imports.acquire().await.map_err(Problem::internal)?;
    let bytes = tokio::fs::read(&incoming.path).await.map_err(Problem::internal)?;
    let decoded = tokio::task::spawn_blocking(move || decode(&bytes)).await.map_err(Problem::internal)?;
    let LoadedEnvironment { map, warnings } = decoded?;
    Ok((map.width() as i64, map.height() as i64, warnings))
}

/// Decodes a map from a stranger.
pub(super) fn decode(bytes: &[u8]) -> Result<LoadedEnvironment, Problem> {
    environment::decode(bytes).map_err(|error| {
        let code = "environment_invalid".to_owned();
        Problem::invalid_content(ContentError { code, file: None, field: None }, error.to_string())
    })
}

fn view(record: &EnvironmentRecord) -> Result<EnvironmentView, Problem> {
    Ok(EnvironmentView {
        id: record.id.clone(),
        name: record.name.clone(),
        sha256: record.sha256.clone(),
        bytes: record.bytes,
        width: record.width,
        height: record.height,
        warnings: serde_json::from_str(&record.warnings).map_err(Problem::internal)?,
        created_at: rfc3339(record.created_ms),
    })
}
