//! `/v1/models/{id}/materials`: the materials of a model and their masks.

use axum::Json;
use axum::extract::State;
use axum::response::Response;
use serde::Deserialize;
use utoipa::IntoParams;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::description::File;
use crate::server::extract::{QueryString, UrlPath};
use crate::server::memory::export_bytes;
use crate::server::problem::Problem;
use crate::server::{models, render_request, renders};
use crate::worker::{LightSource, MaterialChange, ModelContent, RenderTask};
use relume_api::materials::MaterialView;
use relume_api::{List, ModelId, TenantId};
use relume_capture::formats::model_file;
use relume_scene::srgb;
use relume_spec::rendering::{Colour, FrameFormat, MAX_MATERIAL_EDITS, MaterialEdit, Output, Tier};
use relume_train::palette::{Material, first_fault, materials};
use relume_train::render::{EncodeOptions, Neighbours, Viewpoint};

/// The routes that return lists.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(list_materials))
}

/// The routes that return pictures.
pub(super) fn pictures() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(material_mask))
}

/// List the materials of a model
///
/// Returns colour, share of the surface, roughness and metalness of each material, in the order of their numbers. The field `materials`
/// of a render request and of exports changes them for that picture or file.
#[utoipa::path(
    get, path = "/v1/models/{id}/materials", tag = "models",
    params(("id" = String, Path, description = "Model identifier")),
    responses(
        (status = 200, body = List<MaterialView>),
        (status = 404, body = Problem),
        (status = 409, body = Problem, description = "The model has colours only"),
        (status = 503, body = Problem, description = "The server is busy; retry after `Retry-After`")
    )
)]
async fn list_materials(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<ModelId>,
) -> Result<Json<List<MaterialView>>, Problem> {
    let found = of_model(&app, &caller.tenant, &id).await?;
    let items = (0..).zip(&found).map(|(number, material)| view(number, material)).collect();
    Ok(Json(List { items, next: None }))
}

/// Size and direction of a mask.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct MaskQuery {
    /// Side of the square image, 16 to 1024 pixels. Omitted: 256.
    #[param(minimum = 16, maximum = 1024)]
    size: Option<u32>,
    /// Azimuth of the camera, as for a thumbnail.
    azimuth: Option<f64>,
    /// Elevation of the camera, as for a thumbnail.
    #[param(minimum = -90, maximum = 90)]
    elevation: Option<f64>,
}

/// Get the mask of a material
///
/// Returns a PNG: white where the surface has only this material, transparent where there is no surface.
#[utoipa::path(
    get, path = "/v1/models/{id}/materials/{material}/mask", tag = "models",
    params(
        ("id" = String, Path, description = "Model identifier"),
        ("material" = u32, Path, description = "Number of the material, from 0"),
        MaskQuery
    ),
    responses(
        (status = 200, content_type = "image/png", body = File),
        (status = 404, body = Problem),
        (status = 409, body = Problem, description = "The model has colours only"),
        (status = 422, body = Problem), (status = 503, body = Problem)
    )
)]
async fn material_mask(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath((id, material)): UrlPath<(ModelId, u32)>,
    QueryString(query): QueryString<MaskQuery>,
) -> Result<Response, Problem> {
    let orbit = render_request::orbit(query.azimuth, query.elevation, query.size)?;
    let count = of_model(&app, &caller.tenant, &id).await?.len();
    if usize::try_from(material).map_or(true, |k| k >= count) {
        return Err(Problem::not_found("material", &material.to_string()));
    }
    let (mut model, _) = models::source(&app, &caller.tenant, &id).await?;
    model.materials = MaterialChange::Mask(material);
    let task = RenderTask {
        model,
        light: LightSource::Recovered,
        rotation_deg: 0.0,
        exposure_ev: 0.0,
        viewpoint: Viewpoint::Orbit(orbit),
        shows_environment: false,
        quality: Tier::Standard.into(),
        outputs: vec![Output::Albedo],
        ground_height: None,
        lamps: Vec::new(),
        neighbours: Neighbours::default(),
    };
    let picture = renders::render_frame(&app, task, FrameFormat::Png, EncodeOptions::default()).await?;
    Ok(renders::respond(picture, FrameFormat::Png))
}

/// The materials of a model. The model file is read on the threads of uploads.
async fn of_model(app: &AppState, tenant: &TenantId, id: &ModelId) -> Result<Vec<Material>, Problem> {
    let (source, _) = models::source(app, tenant, id).await?;
    let ModelContent::File(path) = source.content else {
        return Err(Problem::internal("the model is not a file"));
    };
    let size = tokio::fs::metadata(&path).await.map_err(Problem::storage_failed)?.len();
    let memory = app.memory.reserve(export_bytes(size, 0)).await?;
    let read = move || {
        let _held = memory;
        let model = model_file::decode(&std::fs::read(&path).map_err(Problem::storage_failed)?);
        let model = model.map_err(Problem::internal)?;
        match model.has_materials() {
            true => Ok(materials(&model)),
            false => Err(Problem::conflict("no-materials", "the model has no materials")),
        }
    };
    app.decoders.run(tenant, read).await?
}

/// Refuses changes of materials that the model does not have, and values out of range.
pub(super) async fn check(
    app: &AppState,
    tenant: &TenantId,
    id: &ModelId,
    edits: &[MaterialEdit],
) -> Result<(), Problem> {
    check_values(edits)?;
    if edits.is_empty() {
        return Ok(());
    }
    let count = of_model(app, tenant, id).await?.len();
    match first_fault(count, edits) {
        None => Ok(()),
        Some((i, field, error)) => {
            Err(Problem::invalid_field(format!("/materials/{i}/{field}"), error.to_string()))
        }
    }
}

/// Refuses values out of range.
pub(super) fn check_values(edits: &[MaterialEdit]) -> Result<(), Problem> {
    if edits.len() > MAX_MATERIAL_EDITS {
        let detail = format!("must have at most {MAX_MATERIAL_EDITS} items");
        return Err(Problem::invalid_field("/materials", detail));
    }
    match edits.iter().enumerate().find_map(|(i, edit)| Some((i, edit.fault()?))) {
        None => Ok(()),
        Some((i, (field, reason))) => Err(Problem::invalid_field(format!("/materials/{i}/{field}"), reason)),
    }
}

fn view(number: u32, material: &Material) -> MaterialView {
    let &Material { albedo, share, roughness, metalness } = material;
    let colour = Colour(albedo.map(|a| srgb::to_u8(srgb::encode(a))));
    MaterialView { material: number, colour, albedo, share, roughness, metalness }
}
