//! `/v1/models`: what trainings produced.

use axum::Json;
use axum::extract::{Path, State};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::api::extract::QueryString;
use crate::api::listing::{List, PageQuery, rfc3339};
use crate::api::{Problem, Shared};
use crate::store::{ModelFile, ModelRecord};
use crate::worker::ModelSource;

/// Name of the file that holds the model itself.
const MODEL_FILE: &str = "model.safetensors";

/// The routes of this family.
pub(super) fn routes() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(list_models)).routes(routes!(get_model)).routes(routes!(get_card))
}

/// A model in a list.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ModelSummary {
    /// Identifier.
    pub id: String,
    /// The job that made it.
    pub job: String,
    /// The capture it shows.
    pub capture: String,
    /// Number of Gaussians.
    pub gaussians: i64,
    /// RFC 3339.
    pub created_at: String,
}

/// A model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ModelView {
    /// What a list shows.
    #[serde(flatten)]
    pub summary: ModelSummary,
    /// Its files.
    pub files: Vec<FileView>,
    /// What was trained, how, and what was decided on what evidence.
    #[schema(value_type = Object)]
    pub card: serde_json::Value,
}

/// A file of a model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct FileView {
    /// Name, e.g. `model.ply`.
    pub name: String,
    /// Media type.
    pub content_type: String,
    /// Size.
    pub bytes: i64,
    /// Hash, lower-case hex; also the file's `ETag`.
    pub sha256: String,
    /// Path to get it at.
    pub href: String,
}

/// List models
#[utoipa::path(
    get, path = "/v1/models", tag = "models", params(PageQuery),
    responses((status = 200, body = List<ModelSummary>))
)]
async fn list_models(
    State(app): State<Shared>,
    QueryString(query): QueryString<PageQuery>,
) -> Result<Json<List<ModelSummary>>, Problem> {
    let page = query.page()?;
    let items = app.store.models(&page).await?.iter().map(summary).collect();
    Ok(Json(List::new(items, &page, |m: &ModelSummary| &m.id)))
}

/// Look at a model and its files
#[utoipa::path(
    get, path = "/v1/models/{id}", tag = "models", params(("id" = String, Path)),
    responses((status = 200, body = ModelView), (status = 404, body = Problem))
)]
async fn get_model(State(app): State<Shared>, Path(id): Path<String>) -> Result<Json<ModelView>, Problem> {
    let model = find(&app, &id).await?;
    let files = app.store.model_files(&id).await?;
    let files = files.iter().map(|f| file_view(&id, f)).collect();
    Ok(Json(ModelView { summary: summary(&model), files, card: card(&model)? }))
}

/// Read a model's card
#[utoipa::path(
    get, path = "/v1/models/{id}/card", tag = "models", params(("id" = String, Path)),
    responses((status = 200, body = Object), (status = 404, body = Problem))
)]
async fn get_card(
    State(app): State<Shared>,
    Path(id): Path<String>,
) -> Result<Json<serde_json::Value>, Problem> {
    Ok(Json(card(&find(&app, &id).await?)?))
}

async fn find(app: &Shared, id: &str) -> Result<ModelRecord, Problem> {
    app.store.model(id).await?.ok_or_else(|| Problem::not_found("model", id))
}

/// The model as the device thread takes it, and its content hash.
pub(super) async fn source(app: &Shared, id: &str) -> Result<(ModelSource, String), Problem> {
    let file = app.store.model_file(id, MODEL_FILE).await?;
    let file = file.ok_or_else(|| Problem::not_found("model", id))?;
    let path = app.store.artifacts().local_path(&file.artifact);
    Ok((ModelSource { id: id.to_owned(), path }, file.sha256))
}

fn card(model: &ModelRecord) -> Result<serde_json::Value, Problem> {
    serde_json::from_str(&model.card).map_err(Problem::internal)
}

fn summary(model: &ModelRecord) -> ModelSummary {
    ModelSummary {
        id: model.id.clone(),
        job: model.job_id.clone(),
        capture: model.capture_id.clone(),
        gaussians: model.gaussians,
        created_at: rfc3339(model.created_ms),
    }
}

fn file_view(model: &str, file: &ModelFile) -> FileView {
    FileView {
        name: file.name.clone(),
        content_type: file.content_type.clone(),
        bytes: file.bytes,
        sha256: file.sha256.clone(),
        href: format!("/v1/models/{model}/files/{}", file.name),
    }
}
