//! `/v1/captures/{id}/photographs`: the list of a capture's photographs, and their images.

use std::sync::Arc;

use axum::Json;
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
use crate::server::cameras::{self, CamerasQuery, WORLD_RULE};
use crate::server::description::File;
use crate::server::extract::{QueryString, UrlPath};
use crate::server::files::{etag, matches_etag};
use crate::server::opened_captures::Opened;
use crate::server::problem::Problem;
use crate::store::{CaptureRecord, StoreError, hex};
use relume_api::photographs::{CapturePhotographs, CapturedPhotograph};
use relume_api::{CaptureId, TenantId};
use relume_capture::formats::image_file;
use relume_capture::{CaptureError, CapturePhotos, PictureOptions};
use relume_scene::{ImageRgba, srgb};

/// Permitted widths, pixels.
const WIDTHS: std::ops::RangeInclusive<u32> = 16..=4096;
/// Maximum width of images that are cached on disk, pixels.
const CACHED_WIDTH: u32 = 1024;
const QUALITY: u8 = 90;

/// The route that reads archives.
pub(super) fn lists() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(list_photographs))
}

/// The route that returns images.
pub(super) fn pictures() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(get_photograph))
}

/// List the photographs of a capture
///
/// Returns all photographs, each with its camera as in `GET /v1/captures/{id}/cameras`, its use as a held-out
/// view, the warnings of the validation and the path of the image.
#[utoipa::path(
    get, path = "/v1/captures/{id}/photographs", tag = "captures",
    params(("id" = String, Path, description = "Capture identifier"), CamerasQuery),
    responses(
        (status = 200, body = CapturePhotographs),
        (status = 304, description = "Not modified: the caller has the current version"),
        (status = 404, body = Problem, description = "The capture does not exist or is not ready"),
        (status = 422, body = Problem)
    )
)]
async fn list_photographs(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<CaptureId>,
    QueryString(query): QueryString<CamerasQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let capture = find(&app, &caller.tenant, &id).await?;
    let (convention, up) = (query.convention, query.world(&app, &caller.tenant).await?);
    let tag = etag(&digest(&capture, &format!("photographs|{WORLD_RULE}|{convention:?}|{up:?}")));
    let mut response = if matches_etag(&headers, &tag) {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        let opened = open(&app, &caller.tenant, &capture).await?;
        let read = move || opened.photographs.cameras(up);
        let taken = app.decoders.run(&caller.tenant, read).await?.map_err(|error| unreadable(&error))?;
        let photograph = |camera| {
            let taken = cameras::view(camera, convention);
            let warnings = capture.report.about(&taken.name);
            let href = format!("/v1/captures/{id}/photographs/{}", segment(&taken.name));
            CapturedPhotograph { taken, warnings, href }
        };
        let photographs = taken.into_iter().map(photograph).collect();
        Json(CapturePhotographs { convention, photographs }).into_response()
    };
    response.headers_mut().insert(header::ETAG, HeaderValue::from_str(&tag).map_err(Problem::internal)?);
    Ok(response)
}

/// Size and distortion of an image.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct PhotographQuery {
    /// Maximum width, 16 to 4096 pixels. Images are never enlarged. Omitted: the stored width.
    #[param(minimum = 16, maximum = 4096)]
    width: Option<u32>,
    /// `true`: removes lens distortion, so that the image matches a frame rendered with the photograph's
    /// camera. Omitted: `false`.
    #[serde(default)]
    #[param(value_type = Option<bool>)]
    undistorted: bool,
}

/// Get a photograph
///
/// Returns a photograph of the capture as JPEG, with transparent pixels over white. `name` is one path
/// segment: write `images/1.jpg` as `images%2F1.jpg`. The bytes never change, so caches can keep them. The
/// server computes the `ETag` without decoding the photograph.
#[utoipa::path(
    get, path = "/v1/captures/{id}/photographs/{name}", tag = "captures",
    params(
        ("id" = String, Path, description = "Capture identifier"),
        ("name" = String, Path, description = "Name of the photograph in the capture, percent-encoded as one path segment"),
        PhotographQuery
    ),
    responses(
        (status = 200, content_type = "image/jpeg", body = File),
        (status = 304, description = "Not modified: the caller has the current version"),
        (status = 404, body = Problem, description = "The capture or the photograph does not exist, or the capture is not ready"),
        (status = 413, body = Problem), (status = 422, body = Problem), (status = 503, body = Problem)
    )
)]
async fn get_photograph(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath((id, name)): UrlPath<(CaptureId, String)>,
    QueryString(query): QueryString<PhotographQuery>,
    method: Method,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    if query.width.is_some_and(|width| !WIDTHS.contains(&width)) {
        return Err(Problem::invalid_field("query/width", "must be 16 to 4096"));
    }
    let options = PictureOptions { width: query.width, undistorted: query.undistorted };
    let capture = find(&app, &caller.tenant, &id).await?;
    let digest = digest(&capture, &format!("{name}|{options:?}"));
    let tag = etag(&digest);
    let mut response = if matches_etag(&headers, &tag) {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        let picture =
            PhotographRequest { caller: &caller, capture: &capture, name: &name, options, digest: &digest };
        let body = picture.found_or_made(&app, method == Method::HEAD).await?;
        ([(header::CONTENT_TYPE, "image/jpeg")], body).into_response()
    };
    let out = response.headers_mut();
    out.insert(header::ETAG, HeaderValue::from_str(&tag).map_err(Problem::internal)?);
    out.insert(header::CACHE_CONTROL, HeaderValue::from_static("private, max-age=31536000, immutable"));
    Ok(response)
}

/// A requested image.
struct PhotographRequest<'a> {
    caller: &'a Caller,
    capture: &'a CaptureRecord,
    name: &'a str,
    options: PictureOptions,
    /// The digest of everything that determines the image.
    digest: &'a str,
}

impl PhotographRequest<'_> {
    /// The cached image, or a new one that is then cached. With `head` only the existence is checked, and the result is empty.
    async fn found_or_made(&self, app: &AppState, head: bool) -> Result<Vec<u8>, Problem> {
        let id = self.capture.id.as_str();
        let is_small = self.options.width.is_some_and(|width| width <= CACHED_WIDTH);
        // Concurrent requests for the same image compute it once.
        let _key_guard = app.thumbnail_locks.take(self.digest).await;
        if is_small && let Some(bytes) = app.thumbnails.get(id, self.digest).await {
            return Ok(bytes);
        }
        let opened = open(app, &self.caller.tenant, self.capture).await?;
        if !opened.photographs.contains(self.name) {
            return Err(Problem::not_found("photograph", self.name));
        }
        if head {
            return Ok(Vec::new());
        }
        let bytes = self.make(app, opened).await?;
        if is_small && !app.store.disk_space().is_short() {
            app.thumbnails.put(id, self.digest, bytes.clone()).await;
            // The capture and its cached images may have been deleted before this image was stored.
            if !matches!(app.store.capture(&self.caller.tenant, &self.capture.id).await, Ok(Some(_))) {
                app.thumbnails.forget_all_of(id).await;
            }
        }
        Ok(bytes)
    }

    async fn make(&self, app: &AppState, opened: Arc<Opened>) -> Result<Vec<u8>, Problem> {
        let tenant = &self.caller.tenant;
        let (options, name, of) = (self.options, self.name.to_owned(), opened.clone());
        let needed = app.decoders.run(tenant, move || of.photographs.picture_bytes(&name, &options)).await?;
        let memory = app.memory.reserve(needed.map_err(|error| unreadable(&error))?).await?;
        let name = self.name.to_owned();
        let work = move || {
            // Held until the work has ended, even if the caller no longer waits.
            let _held = memory;
            Ok(opened.photographs.picture(&name, &options).map(|image| jpeg(&image)))
        };
        let made: Result<_, Problem> = app.decoders.run(tenant, work).await?;
        made?.map_err(|error| unreadable(&error))?.map_err(Problem::internal)
    }
}

/// A capture of the caller in the state `ready`.
async fn find(app: &AppState, tenant: &TenantId, id: &CaptureId) -> Result<CaptureRecord, Problem> {
    let found = app.store.capture(tenant, id).await?;
    found.ok_or_else(|| Problem::not_found("capture", id.as_str()))
}

/// Opens a capture after its file is verified.
///
/// # Errors
/// 404 if the capture was deleted in the meantime.
pub(super) async fn open(
    app: &AppState,
    tenant: &TenantId,
    capture: &CaptureRecord,
) -> Result<Arc<Opened>, Problem> {
    verify(app, tenant, capture).await?;
    app.opened.get(&capture.sha256, async || open_archive(app, tenant, capture).await).await
}

/// Verifies the file of a capture.
///
/// # Errors
/// 404 if the capture was deleted in the meantime.
pub(super) async fn verify(
    app: &AppState,
    tenant: &TenantId,
    capture: &CaptureRecord,
) -> Result<(), Problem> {
    match app.store.artifacts().verify(&capture.artifact, &capture.sha256).await {
        Err(StoreError::Missing(_)) => {
            find(app, tenant, &capture.id).await?;
            Err(Problem::internal("the archive of a capture is missing"))
        }
        sound => Ok(sound?),
    }
}

async fn open_archive(app: &AppState, tenant: &TenantId, capture: &CaptureRecord) -> Result<Opened, Problem> {
    let path = app.store.artifacts().local_path(&capture.artifact);
    let limits = app.import_limits;
    let open = move || CapturePhotos::open(&path, &limits);
    let photographs = app.decoders.run(tenant, open).await?.map_err(|error| unreadable(&error))?;
    Ok(Opened { photographs })
}

/// The problem of a stored capture that cannot be read, although it was valid when it was stored.
pub(super) fn unreadable(error: &CaptureError) -> Problem {
    if error.is_users_fault() { Problem::internal(error) } else { Problem::storage_failed(error) }
}

/// A hash of everything that determines an answer about a capture, including the program's version.
fn digest(capture: &CaptureRecord, what: &str) -> String {
    hex(&Sha256::digest(format!("{}|{}|{what}", env!("CARGO_PKG_VERSION"), capture.sha256)))
}

/// An image as JPEG, over white where it is transparent.
fn jpeg(image: &ImageRgba) -> Result<Vec<u8>, relume_capture::formats::ImageFileError> {
    let over_white = |&[r, g, b, a]: &[f32; 4]| [r, g, b].map(|v| srgb::to_u8(v * a + 1.0 - a));
    let pixels: Vec<[u8; 3]> = image.pixels.iter().map(over_white).collect();
    image_file::encode_jpeg(image.width, image.height, &pixels, QUALITY)
}

/// A name as one path segment (RFC 3986).
fn segment(name: &str) -> String {
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-._~".contains(&byte);
    let written = |byte: u8| match is_plain(byte) {
        true => char::from(byte).to_string(),
        false => format!("%{byte:02X}"),
    };
    name.bytes().map(written).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photograph_name_is_encoded_as_one_path_segment() {
        assert_eq!(segment("images/a b.jpg"), "images%2Fa%20b.jpg");
        assert_eq!(segment("ä?#%.png"), "%C3%A4%3F%23%25.png");
        assert_eq!(segment("IMG_1-2~3.JPG"), "IMG_1-2~3.JPG");
    }
}
