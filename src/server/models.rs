//! `/v1/models`: the results of trainings.

use axum::Json;
use axum::extract::State;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::extract::{JsonBody, QueryString, UrlPath};
use crate::server::listing::rfc3339;
use crate::server::metadata::{self, FilteredPageQuery};
use crate::server::problem::Problem;
use crate::store::{ModelFile, ModelRecord};
use crate::worker::{ModelContent, ModelSource};
use relume_api::calibration::CalibrationView;
use relume_api::metadata::MetadataChange;
use relume_api::models::{FileView, ModelSummary, ModelView};
use relume_api::{List, ModelId, ResourceKind, TenantId};
use relume_capture::Up;
use relume_scene::PhotographedViews;
use relume_train::up_of_card;

/// Name of the file with the model.
pub(super) const MODEL_FILE: &str = "model.safetensors";

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new()
        .routes(routes!(list_models))
        .routes(routes!(get_model, change_model))
        .routes(routes!(get_card))
}

/// List models
///
/// Returns the models of the caller's tenant, newest first.
#[utoipa::path(
    get, path = "/v1/models", tag = "models", params(FilteredPageQuery),
    responses((status = 200, body = List<ModelSummary>))
)]
async fn list_models(
    State(app): State<AppState>,
    caller: Caller,
    QueryString(query): QueryString<FilteredPageQuery>,
) -> Result<Json<List<ModelSummary>>, Problem> {
    let (page, filter) = query.parts()?;
    let page = page.page(async |id| app.store.model(&caller.tenant, &id.into()).await).await?;
    Ok(Json(page.list(app.store.models(&caller.tenant, &filter, &page.store_page()).await?, summary)))
}

/// Get a model
///
/// Returns the model with its files and its model card.
#[utoipa::path(
    get, path = "/v1/models/{id}", tag = "models", params(("id" = String, Path, description = "Model identifier")),
    responses((status = 200, body = ModelView), (status = 404, body = Problem))
)]
async fn get_model(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<ModelId>,
) -> Result<Json<ModelView>, Problem> {
    view(&app, &caller.tenant, &id).await.map(Json)
}

/// A model with its files and its card.
pub(super) async fn view(app: &AppState, tenant: &TenantId, id: &ModelId) -> Result<ModelView, Problem> {
    let model = find(app, tenant, id).await?;
    let files = app.store.model_files(tenant, id).await?;
    let files = files.into_iter().map(|file| file_view(id, file)).collect();
    let (card, calibration) = (model.card.clone(), CalibrationView::of_card(&model.card));
    Ok(ModelView { summary: summary(model), files, calibration, card })
}

/// Change the metadata of a model
///
/// A JSON merge patch (RFC 7396) of name, external identifier and labels. Omitted fields are unchanged; null
/// clears a field. A new model has the metadata of its job at the end of the training. The server does not
/// delete a model with the label `keep:true` because of its age.
#[utoipa::path(
    patch, path = "/v1/models/{id}", tag = "models",
    params(("id" = String, Path, description = "Model identifier")),
    request_body = MetadataChange,
    responses((status = 200, body = ModelSummary), (status = 404, body = Problem), (status = 422, body = Problem))
)]
async fn change_model(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<ModelId>,
    JsonBody(change): JsonBody<MetadataChange>,
) -> Result<Json<ModelSummary>, Problem> {
    metadata::change(&app, &caller.tenant, ResourceKind::Model, id.as_str(), &change).await?;
    Ok(Json(summary(find(&app, &caller.tenant, &id).await?)))
}

/// Get the model card
///
/// Returns the model card: training input, settings, and decisions with their evidence.
#[utoipa::path(
    get, path = "/v1/models/{id}/card", tag = "models",
    params(("id" = String, Path, description = "Model identifier")),
    responses((status = 200, body = Object), (status = 404, body = Problem))
)]
async fn get_card(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<ModelId>,
) -> Result<Json<serde_json::Value>, Problem> {
    Ok(Json(find(&app, &caller.tenant, &id).await?.card))
}

/// A model of a tenant.
///
/// # Errors
/// 404 if it does not exist.
pub(super) async fn find(app: &AppState, tenant: &TenantId, id: &ModelId) -> Result<ModelRecord, Problem> {
    app.store.model(tenant, id).await?.ok_or_else(|| Problem::not_found("model", id.as_str()))
}

/// The up direction of the model's world, with which its capture and camera files in the axes of the capture are read.
pub(super) async fn world_of(app: &AppState, tenant: &TenantId, id: &ModelId) -> Result<Up, Problem> {
    up_of_card(&find(app, tenant, id).await?.card).map_err(Problem::internal)
}

/// The directions from which the model's subject was photographed, if the model records them and exists.
pub(super) async fn photographed_views(
    app: &AppState,
    tenant: &TenantId,
    id: &ModelId,
) -> Result<Option<PhotographedViews>, Problem> {
    let model = app.store.model(tenant, id).await?;
    Ok(model.and_then(|model| PhotographedViews::of_card(&model.card)))
}

/// The model as a source for rendering, and its content hash.
pub(super) async fn source(
    app: &AppState,
    tenant: &TenantId,
    id: &ModelId,
) -> Result<(ModelSource, String), Problem> {
    let file = app.store.verified_model_file(tenant, id, MODEL_FILE).await?;
    let file = file.ok_or_else(|| Problem::not_found("model", id.as_str()))?;
    let path = app.store.artifacts().local_path(&file.artifact);
    Ok((ModelSource::new(id.clone(), ModelContent::File(path)), file.sha256))
}

fn summary(model: ModelRecord) -> ModelSummary {
    ModelSummary {
        id: model.id,
        job: model.job_id,
        capture: model.capture_id,
        gaussians: model.gaussians,
        metadata: model.metadata,
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
