//! `/v1/models/{id}/calibration`: level and colour of a finished model from a surface of known reflectance.
//!
//! The model changes in place: new files are stored, then one transaction names them in place of the old ones.

use axum::Json;
use axum::extract::State;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::extract::{JsonBody, UrlPath};
use crate::server::keyed_locks::KeyGuard;
use crate::server::memory::frame_bytes;
use crate::server::model_rewrite::{self, ModelRewrite};
use crate::server::models;
use crate::server::problem::Problem;
use crate::store::{ModelRecord, StoreError};
use crate::worker::{LightSource, RenderTask};
use relume_api::calibration::{NewCalibration, Patch};
use relume_api::models::ModelView;
use relume_api::{ModelId, TenantId};
use relume_capture::{CaptureError, Up, patch_camera};
use relume_scene::{Camera, Model};
use relume_spec::rendering::{Output, Tier};
use relume_spec::training::GreyCard;
use relume_train::calibration::{
    CalibrationError, calibrate_finished, patch_albedo, total_scale, undo_calibration,
};
use relume_train::render::{Neighbours, Viewpoint};
use relume_train::up_of_card;

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(calibrate_model, undo_calibration_of_model))
}

/// Calibrate a model
///
/// Multiplies the albedo of the model so that a surface in one of its photographs has its known reflectance, and
/// divides the light of the capture by the same factor, by channel. Pictures under the light of the capture
/// hardly change; pictures under other lights do.
///
/// The files of the model change, and so do their `sha256` and `ETag`. Exports that are queued or running begin
/// again with the new files; finished exports stay as they are. The `figures` of the card are those of the
/// training. A further calibration replaces this one. Pictures limit the albedo to 1, so a model with parts that
/// would be brighter may miss the reflectance. The answer is the changed model.
#[utoipa::path(
    put, path = "/v1/models/{id}/calibration", tag = "models",
    params(("id" = String, Path, description = "Model identifier")),
    request_body = NewCalibration,
    responses(
        (status = 200, body = ModelView),
        (status = 404, body = Problem),
        (status = 409, body = Problem, description = "The capture of the model was deleted, or the model has colours only"),
        (status = 413, body = Problem),
        (status = 422, body = Problem, description = "A field is invalid, or the model is too dark or missing on the surface"),
        (status = 503, body = Problem, description = "The server is busy; retry after `Retry-After`")
    )
)]
async fn calibrate_model(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<ModelId>,
    JsonBody(request): JsonBody<NewCalibration>,
) -> Result<Json<ModelView>, Problem> {
    let NewCalibration { patch, reflectance } = request;
    if reflectance.iter().any(|r| !GreyCard::REFLECTANCE.contains(r)) {
        return Err(Problem::invalid_field("/reflectance", "must be 0.01 to 1"));
    }
    let (model, held) = locked(&app, &caller.tenant, &id).await?;
    let up = up_of_card(&model.card).map_err(Problem::internal)?;
    let camera = camera(&app, &caller.tenant, &model, patch.clone(), up).await?;
    let albedo = albedo(&app, &caller.tenant, &id, camera).await?;
    let change = move |model: &mut Model| {
        calibrate_finished(model, albedo, reflectance).map_err(refused)?;
        model.card["calibration"]["patch"] = serde_json::json!(patch);
        Ok(())
    };
    model_rewrite::rewrite(&app, ModelRewrite { tenant: caller.tenant.clone(), model, held }, change).await?;
    models::view(&app, &caller.tenant, &id).await.map(Json)
}

/// Undo the calibration of a model
///
/// Undoes all calibrations of the model since its training, up to rounding. A calibration by the training setting
/// `grey_card` stays. A model without a calibration is unchanged. The answer is the model.
#[utoipa::path(
    delete, path = "/v1/models/{id}/calibration", tag = "models",
    params(("id" = String, Path, description = "Model identifier")),
    responses(
        (status = 200, body = ModelView),
        (status = 404, body = Problem), (status = 413, body = Problem),
        (status = 503, body = Problem, description = "The server is busy; retry after `Retry-After`")
    )
)]
async fn undo_calibration_of_model(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<ModelId>,
) -> Result<Json<ModelView>, Problem> {
    let (model, held) = locked(&app, &caller.tenant, &id).await?;
    if total_scale(&model.card).is_some() {
        let change = |model: &mut Model| {
            undo_calibration(model);
            Ok(())
        };
        model_rewrite::rewrite(&app, ModelRewrite { tenant: caller.tenant.clone(), model, held }, change)
            .await?;
    }
    models::view(&app, &caller.tenant, &id).await.map(Json)
}

/// A model as it is when no other request changes its files, and the lock that keeps it so.
async fn locked(app: &AppState, tenant: &TenantId, id: &ModelId) -> Result<(ModelRecord, KeyGuard), Problem> {
    let held = app.model_locks.take(&format!("{tenant}/{id}")).await;
    Ok((models::find(app, tenant, id).await?, held))
}

/// The camera that sees the patch.
async fn camera(
    app: &AppState,
    tenant: &TenantId,
    model: &ModelRecord,
    patch: Patch,
    up: Up,
) -> Result<Camera, Problem> {
    let found = app.store.capture(tenant, &model.capture_id).await?;
    let capture = found.ok_or_else(|| capture_deleted(model))?;
    match app.store.artifacts().verify(&capture.artifact, &capture.sha256).await {
        Err(StoreError::Missing(_)) if app.store.capture(tenant, &model.capture_id).await?.is_none() => {
            return Err(capture_deleted(model));
        }
        sound => sound?,
    }
    let (path, limits) = (app.store.artifacts().local_path(&capture.artifact), app.import_limits);
    let read = move || patch_camera(&path, &limits, up, &patch.into());
    app.decoders.run(tenant, read).await?.map_err(|error| match error {
        CaptureError::Field { field, reason, .. } => {
            Problem::invalid_field(format!("/{}", field.replace('.', "/")), reason)
        }
        error if error.is_users_fault() => Problem::internal(error),
        error => Problem::storage_failed(error),
    })
}

fn capture_deleted(model: &ModelRecord) -> Problem {
    let detail = format!(
        "capture {:?} was deleted, and with it the photographs of this model; download model.safetensors and run `relume calibrate` \
         with the photographs, or train the capture again",
        model.capture_id.as_str()
    );
    Problem::conflict("capture-deleted", detail)
}

/// The mean albedo that the camera sees, or why there is none. The frame waits in the queue of frames.
async fn albedo(
    app: &AppState,
    tenant: &TenantId,
    id: &ModelId,
    camera: Camera,
) -> Result<Result<[f32; 3], CalibrationError>, Problem> {
    let (model, _) = models::source(app, tenant, id).await?;
    let task = RenderTask {
        model,
        light: LightSource::Recovered,
        rotation_deg: 0.0,
        exposure_ev: 0.0,
        viewpoint: Viewpoint::Camera(camera),
        shows_environment: false,
        quality: Tier::Standard.into(),
        outputs: vec![Output::Albedo],
        ground_height: None,
        lamps: Vec::new(),
        neighbours: Neighbours::default(),
    };
    let _memory = app.memory.reserve(frame_bytes(task.pixels(), &task.outputs, false)).await?;
    Ok(patch_albedo(&app.device.render(task).await?.answer))
}

fn refused(error: CalibrationError) -> Problem {
    let text = error.to_string();
    let reason = text.split_once(": ").map_or(text.as_str(), |(_, reason)| reason);
    match error {
        CalibrationError::NoMaterials => Problem::conflict("no-materials", text),
        CalibrationError::Reflectance(_) => Problem::invalid_field("/reflectance", reason),
        CalibrationError::NotCovered(_) | CalibrationError::TooDark(_) | CalibrationError::NoNeutralPatch => {
            Problem::invalid_field("/patch", reason)
        }
        CalibrationError::Render(_) | CalibrationError::Device(_) => Problem::internal(text),
    }
}
