//! `/v1/models/{id}/exports` and `/v1/exports`.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use serde_json::Value;
use utoipa::IntoParams;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::description::File;
use crate::server::exports::request;
use crate::server::extract::{LargeJson, QueryString, UrlPath};
use crate::server::files::{self, FileRequest, Freshness};
use crate::server::listing::PageQuery;
use crate::server::problem::Problem;
use crate::server::{idempotency, materials};
use crate::store::{ExportDeletion, ExportRecord, ModelFile, StoreError, Submitted};
use relume_api::exports::{ExportState, ExportView, NewExport};
use relume_api::{ExportId, List, ModelId, TenantId};

/// Path of exports.
const EXPORTS: &str = "/v1/exports";
/// Maximum bytes of a body: ten thousand cameras.
const BODY_LIMIT: usize = 8 << 20;

/// The routes of this file.
pub(in crate::server) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new()
        .routes(routes!(create_export))
        .routes(routes!(list_exports))
        .routes(routes!(get_export, delete_export))
        .routes(routes!(get_export_file))
}

/// Queue an export
///
/// `kind` selects the result: `frames` (a zip of images, or an mp4 made with ffmpeg), `gltf`, `usd`, `usdz`,
/// `ply`, `mesh` (a `.glb` with a textured triangle mesh), `light_matrix` (a multi-part EXR with a frame for
/// each lobe of light), or `delight` (a zip with the layers of the photographs). Options and output bytes are the same as those of
/// `relume render`, `relume export` and `relume delight`.
///
/// The server renders the frames of an export one at a time while no other request waits for a frame. After a
/// restart it continues with the completed frames. The header `Idempotency-Key` has the same meaning as for
/// `POST /v1/jobs`.
#[utoipa::path(
    post, path = "/v1/models/{id}/exports", tag = "exports", request_body = NewExport,
    params(
        ("id" = String, Path, description = "Model identifier"),
        ("Idempotency-Key" = Option<String>, Header, description = "Key of the request, 1 to 255 visible ASCII characters")
    ),
    responses(
        (status = 202, body = ExportView),
        (status = 404, body = Problem),
        (status = 409, body = Problem, description = "The capture of the model was deleted, which `delight` needs"),
        (status = 413, body = Problem),
        (status = 422, body = Problem, description = "A field is invalid, or the idempotency key was used with another body"),
        (status = 429, body = Problem, description = "The tenant has the maximum number of queued and running exports")
    )
)]
async fn create_export(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(model): UrlPath<ModelId>,
    headers: HeaderMap,
    LargeJson(body, _body): LargeJson<Value, BODY_LIMIT>,
) -> Result<Response, Problem> {
    let request = request::read(body)?;
    let now_ms = app.jobs.now_ms();
    let key = idempotency::key(&headers, &(&model, &request))?;
    if let Some(key) = &key
        && let Some(answer) = app.store.replayed(&caller.tenant, key, now_ms).await?
    {
        return idempotency::accepted(answer, true, EXPORTS);
    }
    let missing = || Problem::not_found("model", model.as_str());
    let record = app.store.model(&caller.tenant, &model).await?.ok_or_else(missing)?;
    materials::check(&app, &caller.tenant, &model, request.materials()).await?;
    let total = request::check(&app, &caller.tenant, &record, &request).await?;
    app.store.admit_bytes_of(&caller.tenant, 0).await?;
    let id = app.jobs.fresh_id();
    let export = ExportRecord::queued(caller.tenant.clone(), id, model, (&request, total), now_ms);
    let answer = |export: &ExportRecord| serde_json::to_string(&export.clone().view()).unwrap_or_default();
    let most = app.exports.policy.each;
    let submitted = app.store.submit_export(&export, &request, key.as_ref(), most, answer).await;
    let (text, replayed) = match submitted.map_err(|error| caller.problem_for(error))? {
        Submitted::Created(text) => (text, false),
        Submitted::Replayed(text) => (text, true),
    };
    app.exports.wake();
    idempotency::accepted(text, replayed, EXPORTS)
}

/// Filter and page of a list of exports.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct ExportQuery {
    /// Only exports of this model.
    #[param(value_type = Option<String>)]
    model: Option<ModelId>,
    /// Only exports in this state.
    state: Option<ExportState>,
    /// Maximum number of items, 1 to 200. Omitted: 50.
    #[param(minimum = 1, maximum = 200)]
    limit: Option<u32>,
    /// Cursor: the `next` of the previous page, or the identifier of an item. The page starts after that
    /// item. Omitted: the first page.
    #[param(min_length = 1)]
    before: Option<String>,
}

/// List exports
///
/// Returns the exports of the caller's tenant, newest first.
#[utoipa::path(
    get, path = "/v1/exports", tag = "exports", params(ExportQuery),
    responses((status = 200, body = List<ExportView>))
)]
async fn list_exports(
    State(app): State<AppState>,
    caller: Caller,
    QueryString(query): QueryString<ExportQuery>,
) -> Result<Json<List<ExportView>>, Problem> {
    let page = PageQuery { limit: query.limit, before: query.before }
        .page(async |id| app.store.export(&caller.tenant, &id.into()).await)
        .await?;
    let (model, asked) = (query.model.as_ref(), page.store_page());
    let exports = app.store.exports(&caller.tenant, model, query.state, &asked).await?;
    Ok(Json(page.list(exports, ExportRecord::view)))
}

/// Get an export
///
/// Returns state and progress of an export, and the file in the state `succeeded`.
#[utoipa::path(
    get, path = "/v1/exports/{id}", tag = "exports", params(("id" = String, Path, description = "Export identifier")),
    responses((status = 200, body = ExportView), (status = 404, body = Problem))
)]
async fn get_export(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<ExportId>,
) -> Result<Json<ExportView>, Problem> {
    Ok(Json(find(&app, &caller.tenant, &id).await?.view()))
}

/// Cancel or delete an export
///
/// Cancels a queued or running export: the server deletes its frames, and the export remains in the list with
/// the state `cancelled`. Deletes an export in a final state with its file.
#[utoipa::path(
    delete, path = "/v1/exports/{id}", tag = "exports",
    params(("id" = String, Path, description = "Export identifier")),
    responses(
        (status = 200, body = ExportView, description = "Cancelled"),
        (status = 204, description = "Deleted"), (status = 404, body = Problem)
    )
)]
async fn delete_export(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<ExportId>,
) -> Result<Response, Problem> {
    match app.jobs.delete_export(&caller.tenant, &id).await? {
        ExportDeletion::Cancelled(export) => {
            app.exports.stop(&id);
            app.exports.wake();
            Ok(Json(export.view()).into_response())
        }
        ExportDeletion::Deleted => {
            app.gc_wake.notify_one();
            Ok(StatusCode::NO_CONTENT.into_response())
        }
        ExportDeletion::NotFound => Err(Problem::not_found("export", id.as_str())),
    }
}

/// Download the file of an export
///
/// Supports `Range` with one range, `If-Range` and `If-None-Match`. The `ETag` is the SHA-256 of the file. If
/// files are in an object store, the server can redirect callers other than browsers to it (307).
#[utoipa::path(
    get, path = "/v1/exports/{id}/file", tag = "exports",
    params(("id" = String, Path, description = "Export identifier")),
    responses(
        (status = 200, content_type = "application/octet-stream", body = File),
        (status = 206, content_type = "application/octet-stream", body = File),
        (status = 304, description = "Not modified: the caller has the current version"),
        (status = 307, description = "Redirect to the object store; the URL is valid for some minutes"),
        (status = 404, body = Problem, description = "The export does not exist or has no file yet"),
        (status = 416, body = Problem)
    )
)]
async fn get_export_file(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<ExportId>,
    asked: FileRequest,
) -> Result<Response, Problem> {
    let export = find(&app, &caller.tenant, &id).await?;
    let file = file_of(export).ok_or_else(|| Problem::not_found("file of export", id.as_str()))?;
    let mut response = files::send(&app, &asked, (&file, Freshness::ForEver), async || {
        match app.store.artifacts().verify(&file.artifact, &file.sha256).await {
            // The export was deleted in the meantime.
            Err(StoreError::Missing(_)) if app.store.export(&caller.tenant, &id).await?.is_none() => {
                Err(Problem::not_found("export", id.as_str()))
            }
            sound => Ok(sound?),
        }
    })
    .await?;
    let disposition = format!("attachment; filename=\"{}\"", file.name);
    if let Ok(value) = HeaderValue::from_str(&disposition) {
        response.headers_mut().insert(header::CONTENT_DISPOSITION, value);
    }
    Ok(response)
}

async fn find(app: &AppState, tenant: &TenantId, id: &ExportId) -> Result<ExportRecord, Problem> {
    let missing = || Problem::not_found("export", id.as_str());
    app.store.export(tenant, id).await?.ok_or_else(missing)
}

/// The file of a finished export.
fn file_of(export: ExportRecord) -> Option<ModelFile> {
    Some(ModelFile {
        name: export.file_name?,
        content_type: export.content_type?,
        bytes: export.bytes?,
        sha256: export.sha256?,
        artifact: export.artifact?,
    })
}
