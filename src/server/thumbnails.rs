//! `/v1/models/{id}/thumbnail`: small relit images for web pages, which clients can cache.

use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
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
use crate::server::lights::named_light;
use crate::server::problem::Problem;
use crate::server::{models, photograph_angle, render_request, renders};
use crate::store::hex;
use crate::worker::{LightSource, RenderTask};
use relume_api::{ModelId, TenantId};
use relume_spec::rendering::{Background, FrameFormat, Output, Tier, ToneCurve};
use relume_train::render::{EncodeOptions, Neighbours, Orbit, Viewpoint};

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(thumbnail))
}

/// Light, view and format of a thumbnail.
#[derive(Debug, Default, Clone, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ThumbnailQuery {
    /// Light: name of a built-in map, identifier of an uploaded map, `recovered`, or `recovered:GROUP` for a light group of the
    /// model. Omitted: `recovered`.
    pub env: Option<String>,
    /// Side of the square image, 16 to 1024 pixels. Omitted: 256.
    #[param(minimum = 16, maximum = 1024)]
    pub size: Option<u32>,
    /// Azimuth of the camera, degrees counter-clockwise seen from above. For a model whose card has
    /// `photographed_views`, 0 is the first photograph. For other models (older ones, rooms, imported ones) 0
    /// is the +x side. Omitted: 0; for an older model of a capture without masks, the direction from the
    /// middle of its photographs.
    pub azimuth: Option<f64>,
    /// Elevation of the camera, degrees above the horizon, -90 to 90. Omitted: the median of the photographs
    /// for a model whose card has `photographed_views`. For other models 20, or for a capture without masks as
    /// for `azimuth`.
    #[param(minimum = -90, maximum = 90)]
    pub elevation: Option<f64>,
    /// Quality tier: `preview`, `standard` or `high`. Omitted: `preview`.
    #[param(value_type = Option<String>)]
    pub tier: Option<Tier>,
    /// File format: `png` (with alpha) or `jpeg` (over white). Omitted: `png`.
    #[param(value_type = Option<String>, pattern = "^(png|jpeg)$")]
    pub format: Option<FrameFormat>,
    /// Background: `transparent` (JPEG shows white), `environment` (the light) or a colour such as `f4f4f4`.
    /// Omitted: `transparent`.
    #[param(value_type = Option<String>)]
    pub background: Option<Background>,
    /// Tone curve: `srgb`, `neutral` or `agx`. Omitted: `srgb`.
    #[param(value_type = Option<String>, pattern = "^(srgb|neutral|agx)$")]
    pub tone_curve: Option<ToneCurve>,
}

/// Get a thumbnail
///
/// Renders a square image of the model. The same URL gives the same image until the model is calibrated. The server
/// computes the `ETag` without rendering; `HEAD` returns it and renders nothing. The server caches images on its
/// disk. The header `relume-photograph-angle` is that of a render.
#[utoipa::path(
    get, path = "/v1/models/{id}/thumbnail", tag = "models",
    params(("id" = String, Path, description = "Model identifier"), ThumbnailQuery),
    responses(
        (status = 200, content_type = "image/png", body = File),
        (status = 304, description = "Not modified: the caller has the current version"),
        (status = 404, body = Problem), (status = 422, body = Problem), (status = 503, body = Problem)
    )
)]
async fn thumbnail(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<ModelId>,
    QueryString(query): QueryString<ThumbnailQuery>,
    method: Method,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let orbit = render_request::orbit(query.azimuth, query.elevation, query.size)?;
    let format = format(&query)?;
    let tier = tier(&query)?;
    let (model, model_hash) = models::source(&app, &caller.tenant, &id).await?;
    let light =
        named_light(&app, &caller.tenant, query.env.as_deref().unwrap_or("recovered"), "query/env").await?;
    let encoding = finish(&query)?;
    let digest = identity(&model_hash, &light, &orbit, tier, format, &encoding);
    let tag = etag(&digest);
    let mut response = if matches_etag(&headers, &tag) {
        StatusCode::NOT_MODIFIED.into_response()
    } else if method == Method::HEAD {
        [(header::CONTENT_TYPE, format.media_type())].into_response()
    } else {
        let (viewpoint, outputs) = (Viewpoint::Orbit(orbit), vec![Output::Rgb]);
        let task = RenderTask {
            model,
            light,
            rotation_deg: 0.0,
            exposure_ev: 0.0,
            viewpoint,
            shows_environment: encoding.background == Background::Environment,
            quality: tier.into(),
            outputs,
            ground_height: None,
            lamps: Vec::new(),
            neighbours: Neighbours::default(),
        };
        let picture = ThumbnailRequest { tenant: &caller.tenant, digest: &digest, format };
        found_or_rendered(&app, task, encoding, &picture).await?
    };
    if let Some(views) = models::photographed_views(&app, &caller.tenant, &id).await? {
        let direction = views.direction(orbit.azimuth_deg, orbit.elevation_deg);
        photograph_angle::insert(response.headers_mut(), &views, direction);
    }
    let out = response.headers_mut();
    out.insert(header::ETAG, HeaderValue::from_str(&tag).map_err(Problem::internal)?);
    // Caches ask again before each use, because a calibration replaces the files of a model.
    let scope = if caller.has_key { "private, no-cache" } else { "public, no-cache" };
    out.insert(header::CACHE_CONTROL, HeaderValue::from_static(scope));
    Ok(response)
}

/// The identity of a thumbnail in the cache.
struct ThumbnailRequest<'a> {
    tenant: &'a TenantId,
    digest: &'a str,
    format: FrameFormat,
}

/// The cached image, or a new one that is then cached. The caller has checked the access to the model.
async fn found_or_rendered(
    app: &AppState,
    task: RenderTask,
    encoding: EncodeOptions,
    &ThumbnailRequest { tenant, digest, format }: &ThumbnailRequest<'_>,
) -> Result<Response, Problem> {
    let model = task.model.id.clone();
    // Concurrent requests for the same image render it once.
    let _key_guard = app.thumbnail_locks.take(digest).await;
    if let Some(bytes) = app.thumbnails.get(model.as_str(), digest).await {
        return Ok(([(header::CONTENT_TYPE, format.media_type())], bytes).into_response());
    }
    let frame = renders::render_frame(app, task, format, encoding).await?;
    // On a full disk, the cache yields to required writes.
    if !app.store.disk_space().is_short() {
        app.thumbnails.put(model.as_str(), digest, frame.bytes().to_vec()).await;
        // The model and its cached images may have been deleted before this image was stored.
        if !matches!(app.store.model(tenant, &model).await, Ok(Some(_))) {
            app.thumbnails.forget_all_of(model.as_str()).await;
        }
    }
    Ok(renders::respond(frame, format))
}

fn tier(query: &ThumbnailQuery) -> Result<Tier, Problem> {
    match query.tier.unwrap_or(Tier::Preview) {
        Tier::MonteCarlo => Err(Problem::invalid_field("query/tier", "must be preview, standard or high")),
        tier => Ok(tier),
    }
}

fn format(query: &ThumbnailQuery) -> Result<FrameFormat, Problem> {
    match query.format.unwrap_or(FrameFormat::Png) {
        FrameFormat::Exr => Err(Problem::invalid_field("query/format", "must be png or jpeg")),
        format => Ok(format),
    }
}

fn finish(query: &ThumbnailQuery) -> Result<EncodeOptions, Problem> {
    let tone_curve = query.tone_curve.unwrap_or_default();
    if tone_curve == ToneCurve::Linear {
        return Err(Problem::invalid_field("query/tone_curve", "must be srgb, neutral or agx"));
    }
    Ok(EncodeOptions {
        background: query.background.unwrap_or_default(),
        tone_curve,
        ..EncodeOptions::default()
    })
}

/// A hash of everything that determines the image, including the program's version.
fn identity(
    model: &str,
    light: &LightSource,
    orbit: &Orbit,
    tier: Tier,
    format: FrameFormat,
    encoding: &EncodeOptions,
) -> String {
    let (light, version) = (light.key(), env!("CARGO_PKG_VERSION"));
    let EncodeOptions { background, tone_curve, .. } = encoding;
    let text = format!("{version}|{model}|{light}|{orbit:?}|{tier:?}|{format:?}|{background}|{tone_curve:?}");
    hex(&Sha256::digest(text.as_bytes()))
}
