//! `/v1/captures/{id}/cameras`: the cameras of a capture's photographs.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use sha2::{Digest, Sha256};
use utoipa::IntoParams;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::extract::{QueryString, UrlPath};
use crate::server::files::{etag, matches_etag};
use crate::server::models;
use crate::server::problem::Problem;
use crate::store::{StoreError, hex};
use relume_api::cameras::{CameraConvention, CameraSpec, CaptureCameras, CapturedCamera};
use relume_api::{CaptureId, ModelId, TenantId};
use relume_capture::{self, CaptureError, ImportLimits, PhotoCamera, Up};
use relume_spec::training::UpAxis;

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(get_cameras))
}

/// Number of the rules by which imports read poses and find the up direction: answers cached under another one are of another world.
pub(super) const WORLD_RULE: u32 = 3;

/// Form of the cameras.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct CamerasQuery {
    /// Convention of the poses: `opengl`, `opencv` or `colmap`. Omitted: `opengl`.
    #[serde(default)]
    #[param(value_type = Option<String>, pattern = "^(opengl|opencv|colmap)$")]
    pub convention: CameraConvention,
    /// Direction in the files of the capture that is up: the training setting `up` of the model that is rendered with the cameras.
    /// Omitted: `auto`.
    #[serde(default)]
    #[param(value_type = Option<String>, pattern = "^(auto|-?[xyz])$")]
    pub up: UpAxis,
    /// Identifier of the model that is rendered with the cameras: they are in its world, which it records. Cannot be combined with
    /// `up`. Omitted: the world of a new training.
    #[param(value_type = Option<String>)]
    pub model: Option<ModelId>,
}

impl CamerasQuery {
    /// The up direction with which the capture is read.
    ///
    /// # Errors
    /// 404 for an unknown model; 422 for a model with `up`.
    pub(super) async fn world(&self, app: &AppState, tenant: &TenantId) -> Result<Up, Problem> {
        match &self.model {
            Some(_) if !self.up.is_auto() => {
                Err(Problem::invalid_field("query/up", "must not be combined with model, which records it"))
            }
            Some(model) => models::world_of(app, tenant, model).await,
            None => Ok(self.up.into()),
        }
    }
}

/// List the cameras of a capture
///
/// Returns one camera per photograph, after removal of lens distortion, at the stored size. `camera`, `width`
/// and `height` are fields of a render request; a frame rendered with them shows the same view as the
/// photograph. The convention changes only the form of the poses.
#[utoipa::path(
    get, path = "/v1/captures/{id}/cameras", tag = "captures",
    params(("id" = String, Path, description = "Capture identifier"), CamerasQuery),
    responses(
        (status = 200, body = CaptureCameras),
        (status = 304, description = "Not modified: the caller has the current version"),
        (status = 404, body = Problem, description = "The capture does not exist or is not ready"),
        (status = 422, body = Problem)
    )
)]
async fn get_cameras(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<CaptureId>,
    QueryString(query): QueryString<CamerasQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let missing = || Problem::not_found("capture", id.as_str());
    let record = app.store.capture(&caller.tenant, &id).await?.ok_or_else(missing)?;
    let (convention, up) = (query.convention, query.world(&app, &caller.tenant).await?);
    let identity =
        format!("{}|{}|{WORLD_RULE}|{convention:?}|{up:?}", env!("CARGO_PKG_VERSION"), record.sha256);
    let tag = etag(&hex(&Sha256::digest(identity)));
    let mut response = if matches_etag(&headers, &tag) {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        match app.store.artifacts().verify(&record.artifact, &record.sha256).await {
            // The capture was deleted in the meantime.
            Err(StoreError::Missing(_)) if app.store.capture(&caller.tenant, &id).await?.is_none() => {
                return Err(missing());
            }
            sound => sound?,
        }
        let path = app.store.artifacts().local_path(&record.artifact);
        let read = move || relume_capture::cameras(&path, &ImportLimits::default(), up);
        let failed = |error: CaptureError| match error.is_users_fault() {
            true => Problem::internal(error),
            false => Problem::storage_failed(error),
        };
        let cameras = app.decoders.run(&caller.tenant, read).await?.map_err(failed)?;
        let cameras = cameras.into_iter().map(|camera| view(camera, convention)).collect();
        Json(CaptureCameras { convention, cameras }).into_response()
    };
    response.headers_mut().insert(header::ETAG, HeaderValue::from_str(&tag).map_err(Problem::internal)?);
    Ok(response)
}

/// A camera in the form of the API.
pub(super) fn view(photo: PhotoCamera, convention: CameraConvention) -> CapturedCamera {
    let camera = &photo.camera;
    CapturedCamera {
        width: camera.width,
        height: camera.height,
        camera: CameraSpec::of(camera, convention),
        name: photo.name,
        held_out: photo.is_held_out,
        light_rotation_deg: photo.light_rotation_deg,
    }
}
