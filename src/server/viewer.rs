//! `/v1/models/{id}/stream` and `/light`: the data of the browser viewer (docs/viewer-stream.md).

use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use sha2::{Digest, Sha256};
use utoipa::IntoParams;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::description::File;
use crate::server::extract::{QueryString, UrlPath};
use crate::server::files::{etag, matches_etag};
use crate::server::lights::named_light;
use crate::server::memory;
use crate::server::models::{self, MODEL_FILE};
use crate::server::problem::Problem;
use crate::store::{ModelFile, hex};
use crate::worker::LightTask;
use relume_api::ModelId;
use relume_capture::formats::{model_file, viewer_stream};
use relume_train::render::stream_gaussians;

const MEDIA_TYPE: HeaderValue = HeaderValue::from_static("application/octet-stream");
/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(stream)).routes(routes!(light))
}

/// Get the Gaussians of a model for a viewer
///
/// Returns the quantised shader inputs of each Gaussian, in order of importance: the first tenth of the bytes
/// is enough for a recognisable image. The documentation of the viewer stream describes the binary layout.
#[utoipa::path(
    get, path = "/v1/models/{id}/stream", tag = "models",
    params(("id" = String, Path, description = "Model identifier")),
    responses(
        (status = 200, content_type = "application/octet-stream", body = File),
        (status = 304, description = "Not modified: the caller has the current version"),
        (status = 404, body = Problem), (status = 503, body = Problem)
    )
)]
async fn stream(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<ModelId>,
    method: Method,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let missing = || Problem::not_found("model", id.as_str());
    let file = app.store.model_file(&caller.tenant, &id, MODEL_FILE).await?.ok_or_else(missing)?;
    let tag = etag(&identity(&file.sha256, ""));
    let bytes = match answer_without_bytes(&method, &headers, &tag) {
        Some(response) => return described(response, &tag, &caller),
        None => {
            app.store.verified_model_file(&caller.tenant, &id, MODEL_FILE).await?.ok_or_else(missing)?;
            encoded(&app, &file).await?
        }
    };
    described(bytes.into_response(), &tag, &caller)
}

/// The light.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct LightQuery {
    /// Light: name of a built-in map, identifier of an uploaded map, `recovered`, or `recovered:GROUP` for a light group of the
    /// model. Omitted: `recovered`.
    environment: Option<String>,
    /// Rotation about world +Z, degrees, counter-clockwise seen from above. Omitted: 0.
    rotation: Option<f64>,
    /// `true`: includes an image of the light as background. Omitted: `false`.
    map: Option<bool>,
}

/// Get a prepared light for a viewer
///
/// Returns the data with which the tier `standard` shades the model under a light: tables of the light, the
/// separated strong small lights, and the light that reaches each Gaussian, in the order of the model's
/// stream. Exposure is a common factor of all values. The documentation of the viewer stream describes the
/// binary layout.
#[utoipa::path(
    get, path = "/v1/models/{id}/light", tag = "models",
    params(("id" = String, Path, description = "Model identifier"), LightQuery),
    responses(
        (status = 200, content_type = "application/octet-stream", body = File),
        (status = 304, description = "Not modified: the caller has the current version"),
        (status = 404, body = Problem), (status = 422, body = Problem), (status = 503, body = Problem)
    )
)]
async fn light(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<ModelId>,
    QueryString(query): QueryString<LightQuery>,
    method: Method,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let rotation_deg = query.rotation.unwrap_or(0.0);
    if !rotation_deg.is_finite() {
        return Err(Problem::invalid_field("query/rotation", "must be finite"));
    }
    let with_map = query.map.unwrap_or(false);
    let (model, model_hash) = models::source(&app, &caller.tenant, &id).await?;
    let name = query.environment.as_deref().unwrap_or("recovered");
    let light = named_light(&app, &caller.tenant, name, "query/environment").await?;
    let tag = etag(&identity(&model_hash, &format!("{}|{rotation_deg}|{with_map}", light.key())));
    if let Some(response) = answer_without_bytes(&method, &headers, &tag) {
        return described(response, &tag, &caller);
    }
    let found = app.store.model(&caller.tenant, &id).await?;
    let gaussians = found.ok_or_else(|| Problem::not_found("model", id.as_str()))?.gaussians;
    // Held from the queue until the bytes are sent.
    let _permit = app.memory.reserve(memory::light_bytes(gaussians)).await?;
    let served = app.device.light(LightTask { model, light, rotation_deg, with_map }).await?;
    described(served.answer.into_response(), &tag, &caller)
}

/// A hash of everything that determines a stream.
fn identity(model: &str, light: &str) -> String {
    let (program, format) = (env!("CARGO_PKG_VERSION"), viewer_stream::VERSION);
    hex(&Sha256::digest(format!("{program}|{format}|{model}|{light}").as_bytes()))
}

/// The answer to a client that already has the content, or that requests only the head.
fn answer_without_bytes(method: &Method, headers: &HeaderMap, tag: &str) -> Option<Response> {
    match matches_etag(headers, tag) {
        true => Some(StatusCode::NOT_MODIFIED.into_response()),
        false => (method == Method::HEAD).then(|| ().into_response()),
    }
}

/// A response with its headers. Caches ask again before each use, because a calibration replaces the files of a model.
fn described(mut response: Response, tag: &str, caller: &Caller) -> Result<Response, Problem> {
    let cache =
        HeaderValue::from_static(if caller.has_key { "private, no-cache" } else { "public, no-cache" });
    let out = response.headers_mut();
    out.insert(header::ETAG, HeaderValue::from_str(tag).map_err(Problem::internal)?);
    out.insert(header::CACHE_CONTROL, cache);
    out.insert(header::CONTENT_TYPE, MEDIA_TYPE);
    Ok(response)
}

/// Reads a model and encodes it on a blocking thread.
async fn encoded(app: &AppState, file: &ModelFile) -> Result<Vec<u8>, Problem> {
    let size = u64::try_from(file.bytes).map_err(Problem::internal)?;
    let _permit = app.memory.reserve(memory::stream_bytes(size)).await?;
    let path = app.store.artifacts().local_path(&file.artifact);
    let encode = move || -> Result<Vec<u8>, String> {
        let bytes = std::fs::read(&path).map_err(|e| e.to_string())?;
        Ok(stream_gaussians(&model_file::decode(&bytes).map_err(|e| e.to_string())?))
    };
    tokio::task::spawn_blocking(encode).await.map_err(Problem::internal)?.map_err(Problem::internal)
}
