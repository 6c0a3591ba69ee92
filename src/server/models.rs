//! `/v1/models`: what trainings produced.

use axum::Json;
use axum::extract::State;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::api::marks::MarksChange;
use crate::api::models::{FileView, ModelSummary, ModelView};
use crate::api::{List, ModelId, Problem, ResourceKind, TenantId};
use crate::server::app::Shared;
use crate::server::caller::Caller;
use crate::server::extract::{JsonBody, QueryString, UrlPath};
use crate::server::listing::rfc3339;
use crate::server::marks::{self, MarkedPageQuery};
use crate::store::{ModelFile, ModelRecord};
use crate::worker::{ModelContent, ModelSource};

/// Name of the file that holds the model itself.
pub(super) const MODEL_FILE: &str = "model.safetensors";

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .routes(routes!(list_models))
        .routes(routes!(get_model, change_model))
        .routes(routes!(get_card))
}

/// List models
#[utoipa::path(
    get, path = "/v1/models", tag = "models", params(MarkedPageQuery),
    responses((status = 200, body = List<ModelSummary>))
)]
async fn list_models(
    State(app): State<Shared>,
    caller: Caller,
    QueryString(query): QueryString<MarkedPageQuery>,
) -> Result<Json<List<ModelSummary>>, Problem> {
    let (page, filter) = query.parts()?;
    let page = page.page(async |id| app.store.model(&caller.tenant, &id.into()).await).await?;
    Ok(Json(page.list(app.store.models(&caller.tenant, &filter, &page.of_store()).await?, summary)))
}

/// Get a model and its files
#[utoipa::path(
    get, path = "/v1/models/{id}", tag = "models", params(("id" = String, Path)),
    responses((status = 200, body = ModelView), (status = 404, body = Problem))
)]
async fn get_model(
    State(app): State<Shared>,
    caller: Caller,
    UrlPath(id): UrlPath<ModelId>,
) -> Result<Json<ModelView>, Problem> {
    let model = find(&app, &caller.tenant, &id).await?;
    let files = app.store.model_files(&caller.tenant, &id).await?;
    let files = files.into_iter().map(|file| file_view(&id, file)).collect();
    let card = model.card.clone();
    Ok(Json(ModelView { summary: summary(model), files, card }))
}

/// Change what a model is called
///
/// A JSON merge patch: what is absent stays, what is null goes. One with the label `keep:true` is not deleted by age.
/// A model begins with what its job was called when it ended.
#[utoipa::path(
    patch, path = "/v1/models/{id}", tag = "models", params(("id" = String, Path)), request_body = MarksChange,
    responses((status = 200, body = ModelSummary), (status = 404, body = Problem), (status = 422, body = Problem))
)]
async fn change_model(
    State(app): State<Shared>,
    caller: Caller,
    UrlPath(id): UrlPath<ModelId>,
    JsonBody(change): JsonBody<MarksChange>,
) -> Result<Json<ModelSummary>, Problem> {
    marks::change(&app, &caller.tenant, ResourceKind::Model, id.as_str(), &change).await?;
    Ok(Json(summary(find(&app, &caller.tenant, &id).await?)))
}

/// Get a model's card
#[utoipa::path(
    get, path = "/v1/models/{id}/card", tag = "models", params(("id" = String, Path)),
    responses((status = 200, body = Object), (status = 404, body = Problem))
)]
async fn get_card(
    State(app): State<Shared>,
    caller: Caller,
    UrlPath(id): UrlPath<ModelId>,
) -> Result<Json<serde_json::Value>, Problem> {
    Ok(Json(find(&app, &caller.tenant, &id).await?.card))
}

async fn find(app: &Shared, tenant: &TenantId, id: &ModelId) -> Result<ModelRecord, Problem> {
    app.store.model(tenant, id).await?.ok_or_else(|| Problem::not_found("model", id.as_str()))
}

/// The model as the thread of frames takes it, and its content hash.
pub(super) async fn source(
    app: &Shared,
    tenant: &TenantId,
    id: &ModelId,
) -> Result<(ModelSource, String), Problem> {
    let file = app.store.sound_model_file(tenant, id, MODEL_FILE).await?;
    let file = file.ok_or_else(|| Problem::not_found("model", id.as_str()))?;
    let path = app.store.artifacts().local_path(&file.artifact);
    Ok((ModelSource { id: id.clone(), content: ModelContent::File(path) }, file.sha256))
}

fn summary(model: ModelRecord) -> ModelSummary {
    ModelSummary {
        id: model.id,
        job: model.job_id,
        capture: model.capture_id,
        gaussians: model.gaussians,
        marks: model.marks,
        created_at: rfc3339(model.created_ms),
    }
}

fn file_view(model: &ModelId, file: ModelFile) -> FileView {
    FileView {
        href: format!("/v1/models/{model}/files/{}", file.name),
        name: file.name,
        content_type: file.content_type,
        bytes: file.bytes,
        sha256: file.sha256,
    }
}
