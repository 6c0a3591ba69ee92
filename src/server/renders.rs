//! `/v1/models/{id}/render`: relit frames and G-buffers for any camera and light.

use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::description::File;
use crate::server::extract::{LargeJson, UrlPath};
use crate::server::lights::light;
use crate::server::memory::frame_bytes;
use crate::server::problem::Problem;
use crate::server::render_request::{camera, quality};
use crate::server::{materials, models, negotiate, photograph_angle, render_request};
use crate::worker::{MaterialChange, RenderTask};
use relume_api::ModelId;
use relume_api::renders::RenderRequest;
use relume_scene::Camera;
use relume_spec::rendering::{Background, FrameFormat};
use relume_train::render::{EncodeOptions, EncodedFrame, FrameMetadata, Neighbours, Viewpoint};

/// Maximum bytes of a body: a 2k map in Base64 and the other fields.
const BODY_LIMIT: usize = 64 << 20;
const DEPTH_RANGE: HeaderName = HeaderName::from_static("relume-depth-range");

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(render))
}

/// Render a frame
///
/// The header `Accept` selects `image/png` (default), `image/jpeg` or `image/x-exr`.
///
/// The content of a PNG depends on the output. Colours: display-referred with `tone_curve` and straight
/// alpha. `normal`: 16-bit, `(n + 1) / 2`. `depth`: 16-bit grey between the two depths in the header
/// `relume-depth-range`; 65535 where there is no surface. `shadow` and `bounce`: 8-bit with the sRGB curve.
/// Other outputs: 8-bit linear grey.
///
/// An EXR is multi-part and linear and contains every requested output. Colours are premultiplied. Its
/// attributes contain the camera (`worldToCamera`), the model and the light.
///
/// If the model records its photographs, the header `relume-photograph-angle` has the angle between the camera
/// and the nearest photograph, in degrees. Parts that no photograph shows are a guess.
#[utoipa::path(
    post, path = "/v1/models/{id}/render", tag = "models",
    params(("id" = String, Path, description = "Model identifier")),
    request_body = RenderRequest,
    responses(
        (status = 200, content_type = "image/png", body = File),
        (status = 404, body = Problem), (status = 406, body = Problem), (status = 413, body = Problem),
        (status = 422, body = Problem),
        (status = 503, body = Problem, description = "The server is busy; retry after `Retry-After`")
    )
)]
async fn render(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<ModelId>,
    headers: HeaderMap,
    LargeJson(request, _body): LargeJson<RenderRequest, BODY_LIMIT>,
) -> Result<Response, Problem> {
    let format = negotiate::frame_format(&headers)?;
    render_request::check_outputs(&request.outputs, format)?;
    render_request::check_single(&request.outputs)?;
    let encoding = render_request::finish(&request, format)?;
    render_request::check_ground(request.ground_height, &request.outputs)?;
    let size = (request.width, request.height);
    render_request::check_lamps(&request.lamps, &request.outputs, (request.tier, size))?;
    let camera = camera(&request)?;
    let (size, on_gpu) = ((request.width, request.height), app.device.has_gpu());
    let quality = quality(request.tier, request.samples, request.seed, size, on_gpu)?;
    materials::check(&app, &caller.tenant, &id, &request.materials).await?;
    let (mut model, _) = models::source(&app, &caller.tenant, &id).await?;
    model.materials = MaterialChange::Edits(request.materials);
    let light = light(&app, &caller.tenant, &request.environment).await?;
    let task = RenderTask {
        model,
        light,
        rotation_deg: request.environment.rotation_deg,
        exposure_ev: request.environment.exposure_ev,
        viewpoint: Viewpoint::Camera(camera),
        shows_environment: request.background == Background::Environment,
        quality,
        outputs: request.outputs,
        ground_height: request.ground_height,
        lamps: request.lamps,
        neighbours: Neighbours::default(),
    };
    let encoding = EncodeOptions { frame_metadata: notes(&task, Some(camera)), ..encoding };
    let views = models::photographed_views(&app, &caller.tenant, &id).await?;
    let mut response = respond(render_frame(&app, task, format, encoding).await?, format);
    if let Some(views) = views {
        photograph_angle::insert(response.headers_mut(), &views, camera.centre() - views.target);
    }
    Ok(response)
}

/// The metadata of an image file.
pub(super) fn notes(task: &RenderTask, camera: Option<Camera>) -> FrameMetadata {
    FrameMetadata {
        model: task.model.id.to_string(),
        light: task.light.key(),
        rotation_deg: task.rotation_deg,
        exposure_ev: task.exposure_ev,
        quality: task.quality,
        camera,
        frames_per_second: None,
        ground_height: task.ground_height,
        lamps: task.lamps.clone(),
    }
}

/// An encoded frame, with the header `Server-Timing`: queue time and render time.
pub(super) struct TimedFrame {
    encoded: EncodedFrame,
    timing: String,
}

impl TimedFrame {
    /// The bytes of the image file.
    pub(super) fn bytes(&self) -> &[u8] {
        &self.encoded.bytes
    }
}

/// Renders a frame with the lowest priority, when no other request waits for one.
///
/// # Errors
/// As [`render_frame`].
pub(super) async fn render_in_background(
    app: &AppState,
    task: RenderTask,
    format: FrameFormat,
    encoding: EncodeOptions,
) -> Result<Vec<u8>, Problem> {
    let memory =
        app.memory.reserve(frame_bytes(task.pixels(), &task.outputs, !task.lamps.is_empty())).await?;
    let outputs = task.outputs.clone();
    let rendered = app.device.render_in_background(task).await?;
    Ok(app.encoders.encode(rendered.answer, outputs, format, encoding, memory).await?.bytes)
}

/// Renders on a rendering thread and encodes on another.
pub(super) async fn render_frame(
    app: &AppState,
    task: RenderTask,
    format: FrameFormat,
    encoding: EncodeOptions,
) -> Result<TimedFrame, Problem> {
    // Held from the queue to the encoded file.
    let memory =
        app.memory.reserve(frame_bytes(task.pixels(), &task.outputs, !task.lamps.is_empty())).await?;
    let outputs = task.outputs.clone();
    let rendered = app.device.render(task).await?;
    let ms = |d: std::time::Duration| d.as_secs_f64() * 1e3;
    let timing = format!(
        "queue;dur={:.1};desc=\"{} training steps\", render;dur={:.1}",
        ms(rendered.waited),
        rendered.steps_waited,
        ms(rendered.took)
    );
    let encoded = app.encoders.encode(rendered.answer, outputs, format, encoding, memory).await?;
    Ok(TimedFrame { encoded, timing })
}

/// The response with the frame.
pub(super) fn respond(TimedFrame { encoded, timing }: TimedFrame, format: FrameFormat) -> Response {
    let mut response = encoded.bytes.into_response();
    if let Ok(value) = HeaderValue::from_str(&timing) {
        response.headers_mut().insert("server-timing", value);
    }
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(format.media_type()));
    if let Some([near, far]) = encoded.depth_range
        && let Ok(value) = HeaderValue::from_str(&format!("{near} {far}"))
    {
        headers.insert(DEPTH_RANGE, value);
    }
    response
}
