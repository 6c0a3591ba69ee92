//! `/v1/environments`: HDR environment maps.

use axum::Json;
use axum::extract::{Request, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use tokio::io::AsyncReadExt;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::description::{EnvironmentForm, File};
use crate::server::extract::{JsonBody, QueryString, UrlPath};
use crate::server::file_body::{self, AcceptedBody};
use crate::server::listing::rfc3339;
use crate::server::metadata::{self, FilteredPageQuery, MetadataQuery};
use crate::server::problem::Problem;
use crate::store::{EnvironmentRecord, StagedUpload};
use relume_api::environments::{EnvironmentList, EnvironmentView};
use relume_api::metadata::{MetadataChange, ResourceMetadata};
use relume_api::problem::ContentError;
use relume_api::{EnvironmentId, ResourceKind, ResourceName, TenantId};
use relume_capture::BUILTIN;
use relume_capture::formats::environment::{self, EnvironmentFileError, LoadedEnvironment};

/// Number of bytes at the beginning of a file that contain its header.
const HEAD: u64 = 1 << 20;

/// The routes of this file that accept no maps.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new()
        .routes(routes!(list_environments))
        .routes(routes!(get_environment, change_environment))
}

/// The route of this file that accepts a map.
pub(super) fn uploads() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(upload_environment))
}

/// Upload an environment map
///
/// Accepts an equirectangular Radiance `.hdr` or OpenEXR file, as the raw body or as the multipart field
/// `environment`. Row 0 is the direction world +Z. The server refuses NaN and infinity, and sets negative
/// values to 0 with a warning. If the tenant already has a map with the same content, the server answers 200
/// with that map.
#[utoipa::path(
    post, path = "/v1/environments", tag = "environments", params(MetadataQuery),
    request_body(content(
        (File = "image/vnd.radiance"), (File = "image/x-exr"), (EnvironmentForm = "multipart/form-data")
    )),
    responses(
        (status = 201, body = EnvironmentView),
        (status = 200, body = EnvironmentView, description = "Already stored"),
        (status = 413, body = Problem), (status = 415, body = Problem), (status = 422, body = Problem)
    )
)]
async fn upload_environment(
    State(app): State<AppState>,
    caller: Caller,
    QueryString(query): QueryString<MetadataQuery>,
    request: Request,
) -> Result<Response, Problem> {
    let metadata = query.metadata()?;
    let mut incoming = receive(&app, &caller, request).await?;
    if let Some(known) = app.store.environment_by_hash(&caller.tenant, &incoming.sha256).await? {
        let known = with_metadata(&app, &caller.tenant, known, metadata.clone()).await?;
        match app.store.repair_artifact(incoming, &known.artifact).await? {
            None => return Ok(Json(view(known)).into_response()),
            // The map was deleted in the meantime.
            Some(given_back) => incoming = given_back,
        }
    }
    let (width, height, warnings) = validate(&app, &caller.tenant, &incoming).await?;
    let record = EnvironmentRecord {
        id: app.jobs.fresh_id(),
        sha256: incoming.sha256.clone(),
        metadata,
        bytes: i64::try_from(incoming.bytes).unwrap_or(i64::MAX),
        artifact: format!("environments/{}", incoming.sha256),
        width,
        height,
        warnings,
        created_ms: app.jobs.now_ms(),
    };
    let stored =
        app.store.publish_environment(incoming, &caller.tenant, &record).await.map_err(metadata::refused)?;
    let location = format!("/v1/environments/{}", stored.id);
    Ok((StatusCode::CREATED, [(header::LOCATION, location)], Json(view(stored))).into_response())
}

/// An existing map, after its metadata are changed to those of the request.
async fn with_metadata(
    app: &AppState,
    tenant: &TenantId,
    mut map: EnvironmentRecord,
    given: ResourceMetadata,
) -> Result<EnvironmentRecord, Problem> {
    let what = ResourceName::new(ResourceKind::Environment, map.id.to_string());
    map.metadata = metadata::apply_metadata(app, tenant, what, given, map.metadata).await?;
    Ok(map)
}

/// List environment maps
///
/// Returns the names of the built-in maps, and the uploaded maps of the caller's tenant, newest first.
#[utoipa::path(
    get, path = "/v1/environments", tag = "environments", params(FilteredPageQuery),
    responses((status = 200, body = EnvironmentList))
)]
async fn list_environments(
    State(app): State<AppState>,
    caller: Caller,
    QueryString(query): QueryString<FilteredPageQuery>,
) -> Result<Json<EnvironmentList>, Problem> {
    let (page, filter) = query.parts()?;
    let page = page.page(async |id| app.store.environment(&caller.tenant, &id.into()).await).await?;
    let maps = app.store.environments(&caller.tenant, &filter, &page.store_page()).await?;
    Ok(Json(EnvironmentList {
        builtin: BUILTIN.iter().map(|&name| name.to_owned()).collect(),
        uploaded: page.list(maps, view),
    }))
}

/// Get an environment map
///
/// Returns an uploaded map. Built-in maps have a name but no identifier.
#[utoipa::path(
    get, path = "/v1/environments/{id}", tag = "environments",
    params(("id" = String, Path, description = "Environment map identifier")),
    responses((status = 200, body = EnvironmentView), (status = 404, body = Problem))
)]
async fn get_environment(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<EnvironmentId>,
) -> Result<Json<EnvironmentView>, Problem> {
    find(&app, &caller.tenant, &id).await.map(Json)
}

async fn find(app: &AppState, tenant: &TenantId, id: &EnvironmentId) -> Result<EnvironmentView, Problem> {
    let record = app.store.environment(tenant, id).await?;
    record.map(view).ok_or_else(|| Problem::not_found("environment", id.as_str()))
}

/// Change the metadata of an environment map
///
/// A JSON merge patch (RFC 7396) of name, external identifier and labels. Omitted fields are unchanged; null
/// clears a field.
#[utoipa::path(
    patch, path = "/v1/environments/{id}", tag = "environments",
    params(("id" = String, Path, description = "Environment map identifier")),
    request_body = MetadataChange,
    responses((status = 200, body = EnvironmentView), (status = 404, body = Problem), (status = 422, body = Problem))
)]
async fn change_environment(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<EnvironmentId>,
    JsonBody(change): JsonBody<MetadataChange>,
) -> Result<Json<EnvironmentView>, Problem> {
    metadata::change(&app, &caller.tenant, ResourceKind::Environment, id.as_str(), &change).await?;
    find(&app, &caller.tenant, &id).await.map(Json)
}

async fn receive(app: &AppState, caller: &Caller, request: Request) -> Result<StagedUpload, Problem> {
    const MEDIA_TYPES: &[&str] =
        &["image/vnd.radiance", "image/x-hdr", "image/x-exr", "image/aces", "application/octet-stream"];
    let limit = app.limits.environment_bytes;
    let expected = AcceptedBody { field: "environment", media_types: MEDIA_TYPES, takes_files: false, limit };
    file_body::receive(app, caller, request, &expected).await
}

async fn validate(
    app: &AppState,
    tenant: &TenantId,
    incoming: &StagedUpload,
) -> Result<(i64, i64, Vec<String>), Problem> {
    let file = tokio::fs::File::open(&incoming.path).await.map_err(Problem::storage_failed)?;
    let mut head = Vec::new();
    file.take(HEAD).read_to_end(&mut head).await.map_err(Problem::storage_failed)?;
    let needed = environment::decoding_bytes(&head).map_err(refused)?;
    let _memory = app.memory.reserve(needed.saturating_add(incoming.bytes)).await?;
    let bytes = tokio::fs::read(&incoming.path).await.map_err(Problem::storage_failed)?;
    let (maps, sha256) = (app.maps.clone(), incoming.sha256.clone());
    let decode = move || {
        let LoadedEnvironment { map, warnings } = environment::decode(&bytes)?;
        let (width, height) = (map.width() as i64, map.height() as i64);
        // A map is often rendered soon after its upload.
        maps.put(&sha256, map);
        Ok((width, height, warnings))
    };
    app.decoders.run(tenant, decode).await?.map_err(refused)
}

/// Decodes a map from a request, with a permit for the memory.
pub(super) async fn decode(
    app: &AppState,
    tenant: &TenantId,
    bytes: Vec<u8>,
) -> Result<LoadedEnvironment, Problem> {
    let _texels = app.memory.reserve(environment::decoding_bytes(&bytes).map_err(refused)?).await?;
    app.decoders.run(tenant, move || environment::decode(&bytes)).await?.map_err(refused)
}

fn refused(error: EnvironmentFileError) -> Problem {
    let code = "environment_invalid".to_owned();
    Problem::invalid_content(ContentError { code, file: None, field: None }, error.to_string())
}

fn view(record: EnvironmentRecord) -> EnvironmentView {
    EnvironmentView {
        id: record.id,
        metadata: record.metadata,
        sha256: record.sha256,
        bytes: record.bytes,
        width: record.width,
        height: record.height,
        warnings: record.warnings,
        created_at: rfc3339(record.created_ms),
    }
}
