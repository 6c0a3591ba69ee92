//! `/v1/models/{id}/next-photographs`: places for further photographs.

use axum::Json;
use axum::extract::State;
use serde_json::Value;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::exports::path;
use crate::server::extract::{self, LargeJson, UrlPath};
use crate::server::memory::export_bytes;
use crate::server::models;
use crate::server::problem::Problem;
use crate::worker::ModelContent;
use relume_api::ModelId;
use relume_api::cameras::{CameraConvention, CameraSpec};
use relume_api::next_photographs::{NextPhotographView, NextPhotographs, NextPhotographsRequest};
use relume_capture::Up;
use relume_capture::formats::model_file;
use relume_scene::Camera;
use relume_train::trust::{
    MAX_CANDIDATES, NextPhotograph, NextPhotographError, next_photographs, places_around,
};
use relume_train::up_of_card;

/// Permitted numbers of places.
const COUNTS: std::ops::RangeInclusive<u32> = 1..=1000;
/// Maximum bytes of a body: two thousand cameras.
const BODY_LIMIT: usize = 2 << 20;
/// Bytes of memory for a Gaussian in a compared view.
const SHOWN: u64 = 12;
/// Number of cameras around the subject, without `path`.
const PLACES: usize = 144;

/// The route of this file.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(find_next_photographs))
}

/// Find places for further photographs
///
/// Returns the places from which further photographs would help the model most, as `relume capture next` does: each
/// shows surfaces of little confidence, far from the photographs so far. Omitted fields have their defaults; the body
/// may be `{}`.
#[utoipa::path(
    post, path = "/v1/models/{id}/next-photographs", tag = "models", request_body = NextPhotographsRequest,
    params(("id" = String, Path, description = "Model identifier")),
    responses(
        (status = 200, body = NextPhotographs),
        (status = 404, body = Problem),
        (status = 409, body = Problem, description = "The model has no confidence, or its photographs do not surround a subject"),
        (status = 413, body = Problem), (status = 422, body = Problem),
        (status = 503, body = Problem, description = "The server is busy; retry after `Retry-After`")
    )
)]
async fn find_next_photographs(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<ModelId>,
    LargeJson(body, _body): LargeJson<Value, BODY_LIMIT>,
) -> Result<Json<NextPhotographs>, Problem> {
    let request: NextPhotographsRequest = extract::read(body)?;
    if !COUNTS.contains(&request.count) {
        return Err(Problem::invalid_field("/count", "must be 1 to 1000"));
    }
    let record = models::find(&app, &caller.tenant, &id).await?;
    let candidates = candidates(&request, up_of_card(&record.card).map_err(Problem::internal)?)?;
    let (source, _) = models::source(&app, &caller.tenant, &id).await?;
    let ModelContent::File(file) = source.content else {
        return Err(Problem::internal("the model is not a file"));
    };
    let size = tokio::fs::metadata(&file).await.map_err(Problem::storage_failed)?.len();
    let views = candidates.as_ref().map_or(PLACES, Vec::len) as u64;
    let shown = views * record.gaussians.max(0).unsigned_abs() * SHOWN;
    let memory = app.memory.reserve(export_bytes(size, 0) + shown).await?;
    let find = move || {
        let _held = memory;
        let model = model_file::decode(&std::fs::read(&file).map_err(Problem::storage_failed)?);
        let model = model.map_err(Problem::internal)?;
        let candidates = match candidates {
            Some(candidates) => candidates,
            None => places_around(&model).map_err(Problem::internal)?,
        };
        let next = next_photographs(&model, &candidates, request.count as usize).map_err(refused)?;
        Ok(next.iter().map(|next| view(next, &candidates[next.candidate])).collect())
    };
    let cameras: Result<_, Problem> = app.decoders.run(&caller.tenant, find).await?;
    Ok(Json(NextPhotographs { cameras: cameras? }))
}

/// The cameras of a request; `None` if it has none.
fn candidates(request: &NextPhotographsRequest, up: Up) -> Result<Option<Vec<Camera>>, Problem> {
    let Some(json) = &request.path else {
        return match request.path_world {
            Some(_) => Err(Problem::invalid_field("/path_world", "is allowed only with path")),
            None => Ok(None),
        };
    };
    let views = path((json, request.path_world.as_ref()), None, up)?;
    if views.len() > MAX_CANDIDATES {
        let detail = format!("must have at most {MAX_CANDIDATES} cameras, got {}", views.len());
        return Err(Problem::invalid_field("/path", detail));
    }
    Ok(Some(views.into_iter().map(|view| view.camera).collect()))
}

fn view(next: &NextPhotograph, camera: &Camera) -> NextPhotographView {
    NextPhotographView {
        camera: CameraSpec::of(camera, CameraConvention::Opengl),
        width: camera.width,
        height: camera.height,
        candidate: u32::try_from(next.candidate).unwrap_or(u32::MAX),
        azimuth_deg: next.azimuth_deg,
        elevation_deg: next.elevation_deg,
        nearest_deg: next.nearest_deg,
        lack_of_confidence: next.lack,
    }
}

fn refused(error: NextPhotographError) -> Problem {
    match error {
        NextPhotographError::NoConfidence => Problem::conflict("no-confidence", error.to_string()),
        NextPhotographError::NoSubject => Problem::conflict("no-subject", error.to_string()),
    }
}
