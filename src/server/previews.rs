//! `/v1/jobs/{id}/preview`: previews of a running training.

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
use crate::server::description::File;
use crate::server::extract::{QueryString, UrlPath};
use crate::server::files::{etag, matches_etag};
use crate::server::problem::Problem;
use crate::server::{jobs, renders};
use crate::store::hex;
use crate::worker::{LightSource, ModelContent, ModelSource, Preview, RenderTask};
use relume_api::jobs::{JobState, JobView};
use relume_api::{JobId, ModelId};
use relume_spec::rendering::{FrameFormat, Output, Tier};
use relume_train::render::{EncodeOptions, Neighbours, Orbit, Viewpoint};

/// `Retry-After` for a preview that is being made, seconds.
const SOON: u32 = 2;

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(preview))
}

/// View and size of a preview.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct PreviewQuery {
    /// Side of the square image, 16 to 1024 pixels. Omitted: 256.
    #[param(minimum = 16, maximum = 1024)]
    size: Option<u32>,
    /// Azimuth of the camera, degrees counter-clockwise seen from above. 0, and omitted: as in a thumbnail.
    azimuth: Option<f64>,
    /// Elevation of the camera, degrees above the horizon, -90 to 90. Omitted: as in a thumbnail.
    #[param(minimum = -90, maximum = 90)]
    elevation: Option<f64>,
}

/// Get a preview of a running training
///
/// Returns a PNG of the model as it was a few seconds ago, under the recovered light. Before the training of
/// materials, it shows the colours of the photographs. The worker makes previews only while a client requests
/// them, so the first answer is 404 with `Retry-After`. The header `Relume-Step` is the training step of the
/// image; the `ETag` changes with it. When the job has a model, the server redirects to the model's thumbnail
/// (303).
#[utoipa::path(
    get, path = "/v1/jobs/{id}/preview", tag = "jobs",
    params(("id" = String, Path, description = "Job identifier"), PreviewQuery),
    responses(
        (status = 200, content_type = "image/png", body = File),
        (status = 303, description = "Redirect to the thumbnail of the job's model"),
        (status = 304, description = "Not modified: the caller has the current version"),
        (status = 404, body = Problem, description = "The job does not exist or has no preview; `detail` has the reason"),
        (status = 422, body = Problem), (status = 503, body = Problem)
    )
)]
async fn preview(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<JobId>,
    QueryString(query): QueryString<PreviewQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let orbit = query.orbit()?;
    let job = jobs::current(&app, &caller.tenant, &id).await?;
    if let Some(model) = &job.model {
        let to = [(header::LOCATION, query.thumbnail(model)), (header::CACHE_CONTROL, "no-cache".to_owned())];
        return Ok((StatusCode::SEE_OTHER, to).into_response());
    }
    let Some(preview) = app.device.preview(&id) else { return Err(no_preview(&job)) };
    let seen = format!("{id}|{}|{orbit:?}", preview.step);
    let tag = etag(&hex(&Sha256::digest(seen.as_bytes())));
    let mut response = if matches_etag(&headers, &tag) {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        let format = FrameFormat::Png;
        renders::respond(
            renders::render_frame(&app, task(&id, &preview, orbit), format, EncodeOptions::default()).await?,
            format,
        )
    };
    let out = response.headers_mut();
    out.insert(header::ETAG, HeaderValue::from_str(&tag).map_err(Problem::internal)?);
    out.insert(header::CACHE_CONTROL, HeaderValue::from_static("private, no-cache"));
    out.insert("relume-step", HeaderValue::from(preview.step));
    Ok(response)
}

impl PreviewQuery {
    fn orbit(&self) -> Result<Orbit, Problem> {
        let size = self.size.unwrap_or(256);
        if !(16..=1024).contains(&size) {
            return Err(Problem::invalid_field("query/size", "must be 16 to 1024"));
        }
        if !self.azimuth.is_none_or(f64::is_finite) {
            return Err(Problem::invalid_field("query/azimuth", "must be finite"));
        }
        if !self.elevation.is_none_or(|degrees| (-90.0..=90.0).contains(&degrees)) {
            return Err(Problem::invalid_field("query/elevation", "must be -90 to 90"));
        }
        Ok(Orbit { azimuth_deg: self.azimuth, elevation_deg: self.elevation, size })
    }

    /// The same view of a model's thumbnail, relative to the path of the job's preview.
    fn thumbnail(&self, model: &ModelId) -> String {
        let size = self.size.unwrap_or(256);
        let angle = |name: &str, degrees: Option<f64>| {
            degrees.map_or_else(String::new, |degrees| format!("&{name}={degrees}"))
        };
        let (azimuth, elevation) = (angle("azimuth", self.azimuth), angle("elevation", self.elevation));
        format!("../../models/{model}/thumbnail?size={size}{azimuth}{elevation}")
    }
}

fn task(id: &JobId, preview: &Preview, orbit: Orbit) -> RenderTask {
    // A preview shades each Gaussian. Before materials are trained, the stored colours are blended.
    let (output, tier) = match preview.is_relightable {
        true => (Output::Rgb, Tier::Preview),
        false => (Output::Radiance, Tier::Standard),
    };
    RenderTask {
        model: ModelSource::new(id.as_str().into(), ModelContent::Memory(preview.model.clone())),
        light: LightSource::Recovered,
        rotation_deg: 0.0,
        exposure_ev: 0.0,
        viewpoint: Viewpoint::Orbit(orbit),
        shows_environment: false,
        quality: tier.into(),
        outputs: vec![output],
        ground_height: None,
        lamps: Vec::new(),
        neighbours: Neighbours::default(),
    }
}

/// The problem of a job without a model or preview.
fn no_preview(job: &JobView) -> Problem {
    let problem = |why: &str| {
        Problem::new(StatusCode::NOT_FOUND, "no-preview", "The training has no preview").detail(why)
    };
    match job.state {
        JobState::Queued => problem("the job waits in the queue").retry_after(SOON),
        JobState::Running => {
            problem("no preview was requested before; the first one is available after the next step")
                .retry_after(SOON)
        }
        JobState::Cancelling => problem("the job is being cancelled"),
        JobState::Failed | JobState::Cancelled => problem("the job ended without a model"),
        JobState::Succeeded | JobState::Rejected => problem("the job's model was deleted"),
    }
}
