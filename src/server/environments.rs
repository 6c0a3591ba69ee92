//! `/v1/environments`: HDR environment maps.

use axum::Json;
use axum::extract::{Request, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use tokio::io::AsyncReadExt;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::api::environments::{EnvironmentList, EnvironmentView};
use crate::api::marks::{Marks, MarksChange};
use crate::api::problem::ContentError;
use crate::api::{EnvironmentId, Problem, ResourceKind, ResourceName, TenantId};
use crate::capture::BUILTIN;
use crate::formats::environment::{self, EnvironmentFileError, LoadedEnvironment};
use crate::server::app::Shared;
use crate::server::caller::Caller;
use crate::server::description::{EnvironmentForm, File};
use crate::server::extract::{JsonBody, QueryString, UrlPath};
use crate::server::listing::rfc3339;
use crate::server::marks::{self, MarkedPageQuery, MarksQuery};
use crate::server::upload::{self, Expected};
use crate::store::{EnvironmentRecord, Incoming};

/// Bytes from a file's begin that hold its header.
const HEAD: u64 = 1 << 20;

/// The routes of this file that take no maps.
pub(super) fn routes() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .routes(routes!(list_environments))
        .routes(routes!(get_environment, change_environment))
}

/// The route of this file that takes a map.
pub(super) fn uploads() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(upload_environment))
}

/// Upload an environment map
///
/// An equirectangular Radiance `.hdr` or OpenEXR, as the raw body or as the multipart field `environment`. Row 0
/// looks along world +Z. NaN and infinity are refused; negative values are set to 0 with a warning.
#[utoipa::path(
    post, path = "/v1/environments", tag = "environments", params(MarksQuery),
    request_body(content(
        (File = "image/vnd.radiance"), (File = "image/x-exr"), (EnvironmentForm = "multipart/form-data")
    )),
    responses(
        (status = 201, body = EnvironmentView),
        (status = 200, body = EnvironmentView, description = "Stored before"),
        (status = 413, body = Problem), (status = 415, body = Problem), (status = 422, body = Problem)
    )
)]
async fn upload_environment(
    State(app): State<Shared>,
    caller: Caller,
    QueryString(query): QueryString<MarksQuery>,
    request: Request,
) -> Result<Response, Problem> {
    let marks = query.marks()?;
    let mut incoming = receive(&app, &caller, request).await?;
    if let Some(known) = app.store.environment_by_hash(&caller.tenant, &incoming.sha256).await? {
        let known = marked(&app, &caller.tenant, known, marks.clone()).await?;
        match app.store.mend(incoming, &known.artifact).await? {
            None => return Ok(Json(view(known)).into_response()),
            // It was deleted meanwhile.
            Some(given_back) => incoming = given_back,
        }
    }
    let (width, height, warnings) = validate(&app, &incoming).await?;
    let record = EnvironmentRecord {
        id: app.jobs.fresh_id(),
        sha256: incoming.sha256.clone(),
        marks,
        bytes: i64::try_from(incoming.bytes).unwrap_or(i64::MAX),
        artifact: format!("environments/{}", incoming.sha256),
        width,
        height,
        warnings,
        created_ms: app.jobs.now_ms(),
    };
    let stored =
        app.store.keep_environment(incoming, &caller.tenant, &record).await.map_err(marks::refused)?;
    let location = format!("/v1/environments/{}", stored.id);
    Ok((StatusCode::CREATED, [(header::LOCATION, location)], Json(view(stored))).into_response())
}

/// A map that is known, called what its sender calls it.
async fn marked(
    app: &Shared,
    tenant: &TenantId,
    mut map: EnvironmentRecord,
    given: Marks,
) -> Result<EnvironmentRecord, Problem> {
    let what = ResourceName::new(ResourceKind::Environment, map.id.to_string());
    map.marks = marks::mark(app, tenant, what, given, map.marks).await?;
    Ok(map)
}

/// List environment maps
#[utoipa::path(
    get, path = "/v1/environments", tag = "environments", params(MarkedPageQuery),
    responses((status = 200, body = EnvironmentList))
)]
async fn list_environments(
    State(app): State<Shared>,
    caller: Caller,
    QueryString(query): QueryString<MarkedPageQuery>,
) -> Result<Json<EnvironmentList>, Problem> {
    let (page, filter) = query.parts()?;
    let page = page.page(async |id| app.store.environment(&caller.tenant, &id.into()).await).await?;
    let maps = app.store.environments(&caller.tenant, &filter, &page.of_store()).await?;
    Ok(Json(EnvironmentList {
        builtin: BUILTIN.iter().map(|&name| name.to_owned()).collect(),
        uploaded: page.list(maps, view),
    }))
}

/// Get an environment map
#[utoipa::path(
    get, path = "/v1/environments/{id}", tag = "environments", params(("id" = String, Path)),
    responses((status = 200, body = EnvironmentView), (status = 404, body = Problem))
)]
async fn get_environment(
    State(app): State<Shared>,
    caller: Caller,
    UrlPath(id): UrlPath<EnvironmentId>,
) -> Result<Json<EnvironmentView>, Problem> {
    find(&app, &caller.tenant, &id).await.map(Json)
}

async fn find(app: &Shared, tenant: &TenantId, id: &EnvironmentId) -> Result<EnvironmentView, Problem> {
    let record = app.store.environment(tenant, id).await?;
    record.map(view).ok_or_else(|| Problem::not_found("environment", id.as_str()))
}

/// Change what an environment map is called
///
/// A JSON merge patch: what is absent stays, what is null goes.
#[utoipa::path(
    patch, path = "/v1/environments/{id}", tag = "environments", params(("id" = String, Path)), request_body = MarksChange,
    responses((status = 200, body = EnvironmentView), (status = 404, body = Problem), (status = 422, body = Problem))
)]
async fn change_environment(
    State(app): State<Shared>,
    caller: Caller,
    UrlPath(id): UrlPath<EnvironmentId>,
    JsonBody(change): JsonBody<MarksChange>,
) -> Result<Json<EnvironmentView>, Problem> {
    marks::change(&app, &caller.tenant, ResourceKind::Environment, id.as_str(), &change).await?;
    find(&app, &caller.tenant, &id).await.map(Json)
}

async fn receive(app: &Shared, caller: &Caller, request: Request) -> Result<Incoming, Problem> {
    const MEDIA_TYPES: &[&str] =
        &["image/vnd.radiance", "image/x-hdr", "image/x-exr", "image/aces", "application/octet-stream"];
    let limit = app.limits.environment_bytes;
    let expected = Expected { field: "environment", media_types: MEDIA_TYPES, takes_files: false, limit };
    upload::receive(app, caller, request, &expected).await
}

async fn validate(app: &Shared, incoming: &Incoming) -> Result<(i64, i64, Vec<String>), Problem> {
    let file = tokio::fs::File::open(&incoming.path).await.map_err(Problem::storage_failed)?;
    let mut head = Vec::new();
    file.take(HEAD).read_to_end(&mut head).await.map_err(Problem::storage_failed)?;
    let needed = environment::decoding_bytes(&head).map_err(refused)?;
    let _memory = app.memory.borrow(needed.saturating_add(incoming.bytes)).await?;
    let bytes = tokio::fs::read(&incoming.path).await.map_err(Problem::storage_failed)?;
    let decoded = app.decoders.run(move || environment::decode(&bytes)).await?;
    let LoadedEnvironment { map, warnings } = decoded.map_err(refused)?;
    Ok((map.width() as i64, map.height() as i64, warnings))
}

/// Decodes a map that came with a request, with memory for it borrowed meanwhile.
pub(super) async fn decode(app: &Shared, bytes: Vec<u8>) -> Result<LoadedEnvironment, Problem> {
    let _texels = app.memory.borrow(environment::decoding_bytes(&bytes).map_err(refused)?).await?;
    app.decoders.run(move || environment::decode(&bytes)).await?.map_err(refused)
}

fn refused(error: EnvironmentFileError) -> Problem {
    let code = "environment_invalid".to_owned();
    Problem::invalid_content(ContentError { code, file: None, field: None }, error.to_string())
}

fn view(record: EnvironmentRecord) -> EnvironmentView {
    EnvironmentView {
        id: record.id,
        marks: record.marks,
        sha256: record.sha256,
        bytes: record.bytes,
        width: record.width,
        height: record.height,
        warnings: record.warnings,
        created_at: rfc3339(record.created_ms),
    }
}
