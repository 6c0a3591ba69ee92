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

use crate::api::exports::{ExportState, ExportView, NewExport};
use crate::api::{ExportId, List, ModelId, Problem, TenantId};
use crate::server::app::Shared;
use crate::server::caller::Caller;
use crate::server::description::File;
use crate::server::exports::request;
use crate::server::extract::{LargeJson, QueryString, UrlPath};
use crate::server::files::{self, Asked};
use crate::server::idempotency;
use crate::server::listing::PageQuery;
use crate::store::{ExportDeletion, ExportRecord, ModelFile, StoreError, Submitted};

/// Where exports are.
const EXPORTS: &str = "/v1/exports";
/// Largest body: ten thousand cameras.
const BODY_LIMIT: usize = 8 << 20;

/// The routes of this file.
pub(in crate::server) fn routes() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .routes(routes!(create_export))
        .routes(routes!(list_exports))
        .routes(routes!(get_export, delete_export))
        .routes(routes!(get_export_file))
}

/// Queue an export
///
/// `kind` says what is made: `frames` (a zip of images, or an mp4 by ffmpeg), `gltf`, `usd`, `usdz`, `ply`, or `mesh` (a `.glb` of
/// triangles with textures). The options are those of `relume render` and `relume export`, and so are the bytes. Frames are rendered
/// one at a time while nobody else waits for a frame; a server that is stopped goes on with those that are there. With an
/// `Idempotency-Key` header as `POST /v1/jobs`.
#[utoipa::path(
    post, path = "/v1/models/{id}/exports", tag = "exports", request_body = NewExport,
    params(
        ("id" = String, Path),
        ("Idempotency-Key" = Option<String>, Header, description = "1 to 255 visible characters")
    ),
    responses(
        (status = 202, body = ExportView),
        (status = 404, body = Problem), (status = 413, body = Problem),
        (status = 422, body = Problem, description = "A field is wrong, or the key came with another body"),
        (status = 429, body = Problem, description = "As many wait or run as may")
    )
)]
async fn create_export(
    State(app): State<Shared>,
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
    app.store.model(&caller.tenant, &model).await?.ok_or_else(missing)?;
    let total = request::check(&app, &caller.tenant, &request).await?;
    app.store.admit_bytes_of(&caller.tenant, 0).await?;
    let id = app.jobs.fresh_id();
    let export = ExportRecord::queued(caller.tenant.clone(), id, model, (request.kind(), total), now_ms);
    let answer = |export: &ExportRecord| serde_json::to_string(&export.clone().view()).unwrap_or_default();
    let most = app.exports.policy.each;
    let submitted = app.store.submit_export(&export, &request, key.as_ref(), most, answer).await;
    let (text, replayed) = match submitted.map_err(|error| caller.told(error))? {
        Submitted::Created(text) => (text, false),
        Submitted::Replayed(text) => (text, true),
    };
    app.exports.wake();
    idempotency::accepted(text, replayed, EXPORTS)
}

/// Which exports to list.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct ExportQuery {
    /// Only those of this model.
    #[param(value_type = Option<String>)]
    model: Option<ModelId>,
    /// Only those in this state.
    state: Option<ExportState>,
    /// Most items, 1 to 200; 50 when absent.
    #[param(minimum = 1, maximum = 200)]
    limit: Option<u32>,
    /// Only what comes after: the `next` of the page before, or the identifier of an item.
    #[param(min_length = 1)]
    before: Option<String>,
}

/// List exports
#[utoipa::path(
    get, path = "/v1/exports", tag = "exports", params(ExportQuery),
    responses((status = 200, body = List<ExportView>))
)]
async fn list_exports(
    State(app): State<Shared>,
    caller: Caller,
    QueryString(query): QueryString<ExportQuery>,
) -> Result<Json<List<ExportView>>, Problem> {
    let page = PageQuery { limit: query.limit, before: query.before }
        .page(async |id| app.store.export(&caller.tenant, &id.into()).await)
        .await?;
    let (model, asked) = (query.model.as_ref(), page.of_store());
    let exports = app.store.exports(&caller.tenant, model, query.state, &asked).await?;
    Ok(Json(page.list(exports, ExportRecord::view)))
}

/// Get an export
#[utoipa::path(
    get, path = "/v1/exports/{id}", tag = "exports", params(("id" = String, Path)),
    responses((status = 200, body = ExportView), (status = 404, body = Problem))
)]
async fn get_export(
    State(app): State<Shared>,
    caller: Caller,
    UrlPath(id): UrlPath<ExportId>,
) -> Result<Json<ExportView>, Problem> {
    Ok(Json(find(&app, &caller.tenant, &id).await?.view()))
}

/// Cancel or delete an export
///
/// One that waits or runs is cancelled, and stays in the list as `cancelled` without its frames; one that has ended is deleted with its
/// file.
#[utoipa::path(
    delete, path = "/v1/exports/{id}", tag = "exports", params(("id" = String, Path)),
    responses(
        (status = 200, body = ExportView, description = "Cancelled"),
        (status = 204, description = "Deleted"), (status = 404, body = Problem)
    )
)]
async fn delete_export(
    State(app): State<Shared>,
    caller: Caller,
    UrlPath(id): UrlPath<ExportId>,
) -> Result<Response, Problem> {
    match app.store.delete_export(&caller.tenant, &id, app.jobs.now_ms()).await? {
        ExportDeletion::Cancelled(export) => {
            app.exports.stop(&id);
            app.exports.wake();
            Ok(Json(export.view()).into_response())
        }
        ExportDeletion::Deleted => {
            app.tidy.notify_one();
            Ok(StatusCode::NO_CONTENT.into_response())
        }
        ExportDeletion::NotFound => Err(Problem::not_found("export", id.as_str())),
    }
}

/// Download an export
///
/// Answers `Range` (one range), `If-Range` and `If-None-Match`. The `ETag` is the sha256 of the file.
#[utoipa::path(
    get, path = "/v1/exports/{id}/file", tag = "exports", params(("id" = String, Path)),
    responses(
        (status = 200, content_type = "application/octet-stream", body = File),
        (status = 206, content_type = "application/octet-stream", body = File),
        (status = 304, description = "The caller has it already"),
        (status = 307, description = "The object store has it, at a URL that holds for minutes"),
        (status = 404, body = Problem, description = "There is no such export, or no file of it yet"),
        (status = 416, body = Problem)
    )
)]
async fn get_export_file(
    State(app): State<Shared>,
    caller: Caller,
    UrlPath(id): UrlPath<ExportId>,
    asked: Asked,
) -> Result<Response, Problem> {
    let export = find(&app, &caller.tenant, &id).await?;
    let file = file_of(export).ok_or_else(|| Problem::not_found("file of export", id.as_str()))?;
    let mut response = files::send(&app, &asked, &file, async || {
        match app.store.artifacts().verify(&file.artifact, &file.sha256).await {
            // It was deleted meanwhile.
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

async fn find(app: &Shared, tenant: &TenantId, id: &ExportId) -> Result<ExportRecord, Problem> {
    let missing = || Problem::not_found("export", id.as_str());
    app.store.export(tenant, id).await?.ok_or_else(missing)
}

/// The file of an export that has one.
fn file_of(export: ExportRecord) -> Option<ModelFile> {
    Some(ModelFile {
        name: export.file_name?,
        content_type: export.content_type?,
        bytes: export.bytes?,
        sha256: export.sha256?,
        artifact: export.artifact?,
    })
}
