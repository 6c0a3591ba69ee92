//! `/v1/models/{id}/render`: relit frames and G-buffers for any camera under any light.

use std::sync::Arc;

use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::{DMat4, DVec3};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::api::description::File;
use crate::api::extract::JsonBody;
use crate::api::picture::{self, Format, Picture};
use crate::api::{Problem, Shared, environments, models};
use crate::capture::BUILTIN;
use crate::render::{Output, Quality, Tier};
use crate::scene::{Camera, CameraError};
use crate::store::hex;
use crate::worker::{LightSource, RenderTask, View};

/// Largest body: a 2k map in base64 and the rest.
const BODY_LIMIT: usize = 64 << 20;
/// Longest side of a frame, pixels.
const MAX_SIDE: u32 = 4096;
/// Most queries through the Gaussians a frame of the reference tier may cost: some seconds of the device thread.
const MOST_QUERIES: u64 = 1 << 21;
const DEPTH_RANGE: HeaderName = HeaderName::from_static("relume-depth-range");

/// The routes of this family.
pub(super) fn routes() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(render))
}

/// A frame to render.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RenderRequest {
    /// From where.
    pub camera: CameraSpec,
    /// Under which light; the light of the capture, as it was recovered, when absent.
    #[serde(default)]
    pub environment: EnvironmentSpec,
    /// 1 to 4096 pixels.
    pub width: u32,
    /// 1 to 4096 pixels.
    pub height: u32,
    /// `preview`, `standard` (the default), `high` (shadows of strong small lights) or `reference` (Monte-Carlo, slow).
    #[serde(default)]
    #[schema(value_type = String, example = "standard")]
    pub tier: Tier,
    /// Directions a pixel that the tier `reference` draws; 64 when absent. Times the pixels at most 2,097,152.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(minimum = 1, maximum = 65536)]
    pub samples: Option<u32>,
    /// Seed of those directions; 0 when absent. Equal requests give equal bytes.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub seed: Option<u64>,
    /// `rgb albedo normal metallic roughness visibility depth alpha diffuse specular radiance`; `["rgb"]` when
    /// absent. PNG and JPEG hold one, EXR holds all.
    #[serde(default = "rgb_only")]
    #[schema(value_type = Vec<String>, example = json!(["rgb"]))]
    pub outputs: Vec<Output>,
}

/// A camera: either `look_at`, or `camera_to_world` with `fov_y_deg` or `intrinsics`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CameraSpec {
    /// Rows of the camera-to-world matrix, OpenGL axes (x right, y up, looking along -z), capture units.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub camera_to_world: Option<[[f64; 4]; 4]>,
    /// Vertical field of view, degrees, with `camera_to_world`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub fov_y_deg: Option<f64>,
    /// Pixels of the requested size, with `camera_to_world`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub intrinsics: Option<IntrinsicsSpec>,
    /// A camera by what it looks at.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub look_at: Option<LookAtSpec>,
}

/// A pinhole in pixels; pixel centres lie at +0.5.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct IntrinsicsSpec {
    /// Focal length along x.
    pub fx: f64,
    /// Focal length along y.
    pub fy: f64,
    /// Principal point x.
    pub cx: f64,
    /// Principal point y.
    pub cy: f64,
}

/// A camera by what it looks at, capture units.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LookAtSpec {
    /// Where it stands.
    pub eye: [f64; 3],
    /// What it looks at.
    pub target: [f64; 3],
    /// What is up; world +Z when absent.
    #[serde(default = "world_up")]
    pub up: [f64; 3],
    /// Vertical field of view, degrees.
    pub fov_y_deg: f64,
}

/// A light: at most one of `id`, `builtin` and `inline_base64`; none of them means the capture's own.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct EnvironmentSpec {
    /// Identifier of an uploaded map.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub id: Option<String>,
    /// Name of a built-in map, or `recovered`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub builtin: Option<String>,
    /// A `.hdr` or `.exr` file in base64.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub inline_base64: Option<String>,
    /// Turn about world +Z, degrees counter-clockwise seen from above.
    #[serde(default)]
    pub rotation_deg: f64,
    /// Exposure, stops, -20 to 20.
    #[serde(default)]
    pub exposure_ev: f64,
}

fn rgb_only() -> Vec<Output> {
    vec![Output::Rgb]
}

fn world_up() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}

/// Render a frame
///
/// `Accept` chooses between `image/png` (the default), `image/jpeg` and `image/x-exr`. A PNG of a colour is
/// display-referred (clamp, sRGB curve, straight alpha); of `normal` it is 16-bit `(n + 1) / 2`; of `depth` 16-bit
/// grey between the two depths in the header `relume-depth-range`, 65535 where nothing is; of anything else 8-bit
/// linear grey. An EXR is multi-part and linear, with every output asked for.
#[utoipa::path(
    post, path = "/v1/models/{id}/render", tag = "models", params(("id" = String, Path)),
    request_body = RenderRequest,
    responses(
        (status = 200, content_type = "image/png", body = File),
        (status = 404, body = Problem), (status = 406, body = Problem), (status = 413, body = Problem),
        (status = 422, body = Problem), (status = 503, body = Problem, description = "Busy; try again")
    )
)]
async fn render(
    State(app): State<Shared>,
    Path(id): Path<String>,
    headers: HeaderMap,
    JsonBody(request): JsonBody<RenderRequest, BODY_LIMIT>,
) -> Result<Response, Problem> {
    let format = Format::negotiate(&headers)?;
    check_outputs(&request.outputs, format)?;
    let camera = camera(&request)?;
    let quality = quality(&request)?;
    let (model, _) = models::source(&app, &id).await?;
    check_exposure(&request.environment)?;
    let light = light(&app, &request.environment).await?;
    let task = RenderTask {
        model,
        light,
        rotation_deg: request.environment.rotation_deg,
        exposure_ev: request.environment.exposure_ev,
        view: View::Camera(camera),
        quality,
        outputs: request.outputs,
    };
    let shown = picture(&app, task, format).await?;
    Ok(respond(shown, format))
}

/// An encoded picture and a `Server-Timing` header's value: how long it waited and took.
pub(super) struct Shown {
    picture: Picture,
    timing: String,
}

/// Renders on the device thread and encodes off it.
pub(super) async fn picture(app: &Shared, task: RenderTask, format: Format) -> Result<Shown, Problem> {
    let outputs = task.outputs.clone();
    let rendered = app.device.render(task).await?;
    let ms = |d: std::time::Duration| d.as_secs_f64() * 1e3;
    let timing = format!(
        "queue;dur={:.1};desc=\"{} training steps\", render;dur={:.1}",
        ms(rendered.waited),
        rendered.steps_waited,
        ms(rendered.took)
    );
    let encoded = tokio::task::spawn_blocking(move || picture::encode(&rendered.frame, &outputs, format));
    let picture = encoded.await.map_err(Problem::internal)?.map_err(Problem::internal)?;
    Ok(Shown { picture, timing })
}

pub(super) fn respond(Shown { picture, timing }: Shown, format: Format) -> Response {
    let mut response = picture.bytes.into_response();
    if let Ok(value) = HeaderValue::from_str(&timing) {
        response.headers_mut().insert("server-timing", value);
    }
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(format.media_type()));
    if let Some([near, far]) = picture.depth_range
        && let Ok(value) = HeaderValue::from_str(&format!("{near} {far}"))
    {
        headers.insert(DEPTH_RANGE, value);
    }
    response
}

fn check_outputs(outputs: &[Output], format: Format) -> Result<(), Problem> {
    let refuse = |why: &str| Err(Problem::invalid_field("/outputs", why));
    match (outputs, format) {
        ([], _) => refuse("must name at least one output"),
        ([_], Format::Png) | (_, Format::Exr) => Ok(()),
        ([one], Format::Jpeg) if picture::is_colour(*one) => Ok(()),
        ([_], Format::Jpeg) => refuse("is data, which JPEG would spoil; accept image/png or image/x-exr"),
        _ => refuse("only image/x-exr holds several outputs"),
    }
}

fn check_exposure(spec: &EnvironmentSpec) -> Result<(), Problem> {
    if !(-20.0..=20.0).contains(&spec.exposure_ev) {
        return Err(Problem::invalid_field("/environment/exposure_ev", "must be -20 to 20"));
    }
    if !spec.rotation_deg.is_finite() {
        return Err(Problem::invalid_field("/environment/rotation_deg", "must be finite"));
    }
    Ok(())
}

/// The tier asked for, at a cost that others who wait can bear.
fn quality(request: &RenderRequest) -> Result<Quality, Problem> {
    let quality = Quality {
        tier: request.tier,
        samples: request.samples.unwrap_or(Quality::SAMPLES),
        seed: request.seed.unwrap_or(0),
    };
    let most = match request.tier {
        Tier::Reference => MOST_QUERIES / (u64::from(request.width) * u64::from(request.height)).max(1),
        _ => u64::MAX,
    };
    let most = most.min(u64::from(Quality::MOST_SAMPLES));
    if !(1..=most).contains(&u64::from(quality.samples)) {
        let detail = match most {
            0 => format!("the tier reference takes pictures of at most {MOST_QUERIES} pixels"),
            most => format!("must be 1 to {most} at this tier and size, got {}", quality.samples),
        };
        return Err(Problem::invalid_field("/samples", detail));
    }
    Ok(quality)
}

/// The camera asked for.
fn camera(request: &RenderRequest) -> Result<Camera, Problem> {
    for (field, side) in [("/width", request.width), ("/height", request.height)] {
        if !(1..=MAX_SIDE).contains(&side) {
            return Err(Problem::invalid_field(field, format!("must be 1 to {MAX_SIDE}, got {side}")));
        }
    }
    let size = (request.width, request.height);
    let spec = &request.camera;
    match (&spec.look_at, &spec.camera_to_world) {
        (Some(look), None) => {
            if spec.fov_y_deg.is_some() || spec.intrinsics.is_some() {
                let detail = "look_at brings its own fov_y_deg; intrinsics go with camera_to_world";
                return Err(Problem::invalid_field("/camera", detail));
            }
            let [eye, target, up] = [look.eye, look.target, look.up].map(DVec3::from_array);
            Camera::look_at(eye, target, up, look.fov_y_deg.to_radians(), size)
                .map_err(|e| camera_refused("/camera/look_at", &e))
        }
        (None, Some(rows)) => {
            let (focal, centre) = intrinsics(spec, size)?;
            let matrix = DMat4::from_cols_array_2d(rows).transpose();
            Camera::from_opengl(&matrix, size, focal, centre).map_err(|e| camera_refused("/camera", &e))
        }
        _ => Err(Problem::invalid_field("/camera", "must have either look_at or camera_to_world")),
    }
}

type Pair = (f64, f64);

/// Focal lengths and principal point in pixels.
fn intrinsics(spec: &CameraSpec, (width, height): (u32, u32)) -> Result<(Pair, Pair), Problem> {
    match (&spec.intrinsics, spec.fov_y_deg) {
        (Some(i), None) => Ok(((i.fx, i.fy), (i.cx, i.cy))),
        (None, Some(fov)) if fov > 0.0 && fov < 180.0 => {
            let focal = 0.5 * f64::from(height) / (0.5 * fov.to_radians()).tan();
            Ok(((focal, focal), (0.5 * f64::from(width), 0.5 * f64::from(height))))
        }
        (None, Some(_)) => {
            Err(Problem::invalid_field("/camera/fov_y_deg", "must lie strictly between 0 and 180"))
        }
        _ => Err(Problem::invalid_field("/camera", "must have either fov_y_deg or intrinsics")),
    }
}

/// From the camera's own field names to the request's.
fn camera_refused(base: &str, error: &CameraError) -> Problem {
    let pointer = match error.field {
        "transform_matrix" => format!("{base}/camera_to_world"),
        "fov_y" => format!("{base}/fov_y_deg"),
        field @ ("fx" | "fy" | "cx" | "cy") => format!("{base}/intrinsics/{field}"),
        field => format!("{base}/{field}"),
    };
    Problem::invalid_field(pointer, error.reason.clone())
}

/// The light asked for, checked as far as that costs nothing.
async fn light(app: &Shared, spec: &EnvironmentSpec) -> Result<LightSource, Problem> {
    match (&spec.id, &spec.builtin, &spec.inline_base64) {
        (None, None, None) => Ok(LightSource::Recovered),
        (Some(id), None, None) => {
            let found = stored_light(app, id).await?;
            found.ok_or_else(|| Problem::invalid_field("/environment/id", format!("{id:?} does not exist")))
        }
        (None, Some(name), None) => builtin_light(name).ok_or_else(|| {
            let detail = format!("must be recovered or one of {}", BUILTIN.join(", "));
            Problem::invalid_field("/environment/builtin", detail)
        }),
        (None, None, Some(text)) => inline_light(app, text).await,
        _ => Err(Problem::invalid_field("/environment", "must have one of id, builtin and inline_base64")),
    }
}

/// An uploaded map.
pub(super) async fn stored_light(app: &Shared, id: &str) -> Result<Option<LightSource>, Problem> {
    let record = app.store.environment(id).await?;
    Ok(record.map(|record| LightSource::Stored {
        path: app.store.artifacts().local_path(&record.artifact),
        sha256: record.sha256,
    }))
}

/// A map that comes with the program, or the capture's own light.
pub(super) fn builtin_light(name: &str) -> Option<LightSource> {
    match name {
        "recovered" => Some(LightSource::Recovered),
        name if BUILTIN.contains(&name) => Some(LightSource::Builtin(name.to_owned())),
        _ => None,
    }
}

async fn inline_light(app: &Shared, text: &str) -> Result<LightSource, Problem> {
    let bytes = STANDARD
        .decode(text.trim())
        .map_err(|e| Problem::invalid_field("/environment/inline_base64", format!("is not base64: {e}")))?;
    let sha256 = hex(&Sha256::digest(&bytes));
    let _turn = app.imports.acquire().await.map_err(Problem::internal)?;
    let decoded = tokio::task::spawn_blocking(move || environments::decode(&bytes));
    let loaded = decoded.await.map_err(Problem::internal)??;
    Ok(LightSource::Inline { sha256, map: Arc::new(loaded.map) })
}
