//! `/v1/models/{id}/files/{name}`: files with ranges, strong validators and digests (RFC 9110, 9530).

use std::ops::Range;
use std::time::Duration;

use axum::body::Body;
use axum::extract::{FromRequestParts, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::description::File;
use crate::server::extract::UrlPath;
use crate::server::problem::Problem;
use crate::store::ModelFile;
use relume_api::ModelId;

/// How long caches may keep a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Freshness {
    /// The file never changes.
    ForEver,
    /// Caches ask again before each use, because a calibration replaces the files of a model.
    AskAgain,
}

/// Validity of a URL of the object store.
const SIGNED_URL_LIFETIME: Duration = Duration::from_secs(900);
const REPR_DIGEST: HeaderName = HeaderName::from_static("repr-digest");

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(get_file))
}

/// Download a file of a model
///
/// Supports `Range` with one range, `If-Range` and `If-None-Match`. The `ETag` is the SHA-256 of the file. If
/// files are in an object store, the server can redirect callers other than browsers to it (307).
#[utoipa::path(
    get, path = "/v1/models/{id}/files/{name}", tag = "models",
    params(
        ("id" = String, Path, description = "Model identifier"),
        ("name" = String, Path, description = "File name")
    ),
    responses(
        (status = 200, content_type = "application/octet-stream", body = File),
        (status = 206, content_type = "application/octet-stream", body = File),
        (status = 304, description = "Not modified: the caller has the current version"),
        (status = 307, description = "Redirect to the object store; the URL is valid for some minutes"),
        (status = 404, body = Problem), (status = 416, body = Problem)
    )
)]
async fn get_file(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath((id, name)): UrlPath<(ModelId, String)>,
    asked: FileRequest,
) -> Result<Response, Problem> {
    let missing = || Problem::not_found("file", &format!("{id}/{name}"));
    let file = app.store.model_file(&caller.tenant, &id, &name).await?.ok_or_else(missing)?;
    send(&app, &asked, (&file, Freshness::AskAgain), async || {
        app.store.verified_model_file(&caller.tenant, &id, &name).await?.map(drop).ok_or_else(missing)
    })
    .await
}

/// The conditions of a request for a file.
pub(super) struct FileRequest {
    method: Method,
    headers: HeaderMap,
}

impl<S: Sync> FromRequestParts<S> for FileRequest {
    type Rejection = std::convert::Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Self::Rejection> {
        Ok(Self { method: parts.method.clone(), headers: parts.headers.clone() })
    }
}

impl FileRequest {
    /// Whether the caller follows a redirect. Browsers are not redirected: scripts may only request this server, and a redirected
    /// file would be saved under its name in the object store. A URL of an object store is valid only for `GET`.
    fn accepts_redirect(&self) -> bool {
        self.method == Method::GET && !self.headers.contains_key("sec-fetch-mode")
    }
}

/// Answers with a file, its requested range, or a redirect to the object store. `check` verifies its hash before any bytes are
/// sent from this server.
///
/// # Errors
/// The errors of `check`. When the file cannot be read.
pub(super) async fn send(
    app: &AppState,
    asked: &FileRequest,
    (file, freshness): (&ModelFile, Freshness),
    check: impl AsyncFnOnce() -> Result<(), Problem>,
) -> Result<Response, Problem> {
    let size = u64::try_from(file.bytes).map_err(Problem::internal)?;
    let (etag, headers) = (etag(&file.sha256), &asked.headers);
    if matches_etag(headers, &etag) {
        let mut response = StatusCode::NOT_MODIFIED.into_response();
        describe(response.headers_mut(), file, &etag, freshness);
        return Ok(response);
    }
    let (status, range) = match requested(headers, &etag, size) {
        Requested::Whole => (StatusCode::OK, 0..size),
        Requested::Part(range) => (StatusCode::PARTIAL_CONTENT, range),
        Requested::Unsatisfiable => return Ok(unsatisfiable(size)),
    };
    if asked.accepts_redirect()
        && let Some(url) = app.store.artifacts().signed_url(&file.artifact, SIGNED_URL_LIFETIME).await?
    {
        return redirect(file, &etag, &url);
    }
    check().await?;
    let stream = app.store.artifacts().stream(&file.artifact, range.clone()).await?;
    let mut response = (status, Body::from_stream(stream)).into_response();
    let out = response.headers_mut();
    describe(out, file, &etag, freshness);
    out.insert(header::CONTENT_LENGTH, HeaderValue::from(range.end - range.start));
    if status == StatusCode::PARTIAL_CONTENT {
        let text = format!("bytes {}-{}/{size}", range.start, range.end - 1);
        out.insert(header::CONTENT_RANGE, HeaderValue::from_str(&text).map_err(Problem::internal)?);
    }
    Ok(response)
}

/// A redirect to the object store. The validator and the digest are those of the file, so that the client can compare them.
fn redirect(file: &ModelFile, etag: &str, url: &str) -> Result<Response, Problem> {
    let mut response = StatusCode::TEMPORARY_REDIRECT.into_response();
    describe(response.headers_mut(), file, etag, Freshness::AskAgain);
    let entries = [(header::LOCATION, url), (header::CACHE_CONTROL, "no-store")];
    for (name, value) in entries {
        response.headers_mut().insert(name, HeaderValue::from_str(value).map_err(Problem::internal)?);
    }
    Ok(response)
}

/// A strong validator from a content hash.
pub(super) fn etag(sha256: &str) -> String {
    format!("\"{sha256}\"")
}

/// Whether the caller already has this content.
pub(super) fn matches_etag(headers: &HeaderMap, etag: &str) -> bool {
    let values = headers.get_all(header::IF_NONE_MATCH).iter().filter_map(|v| v.to_str().ok());
    values.flat_map(|v| v.split(',')).map(str::trim).any(|v| v == "*" || v.trim_start_matches("W/") == etag)
}

fn describe(headers: &mut HeaderMap, file: &ModelFile, etag: &str, freshness: Freshness) {
    let cache = match freshness {
        Freshness::ForEver => "private, max-age=31536000, immutable",
        Freshness::AskAgain => "private, no-cache",
    };
    let digest: Vec<u8> =
        file.sha256.as_bytes().as_chunks::<2>().0.iter().filter_map(|pair| nibbles(*pair)).collect();
    let entries = [
        (header::ETAG, etag.to_owned()),
        (header::CONTENT_TYPE, file.content_type.clone()),
        (header::ACCEPT_RANGES, "bytes".to_owned()),
        (header::CACHE_CONTROL, cache.to_owned()),
        (REPR_DIGEST, format!("sha-256=:{}:", STANDARD.encode(digest))),
    ];
    for (name, value) in entries {
        if let Ok(value) = HeaderValue::from_str(&value) {
            headers.insert(name, value);
        }
    }
}

fn nibbles([high, low]: [u8; 2]) -> Option<u8> {
    let digit = |c: u8| char::from(c).to_digit(16);
    u8::try_from(digit(high)? * 16 + digit(low)?).ok()
}

fn unsatisfiable(size: u64) -> Response {
    let problem = Problem::new(
        StatusCode::RANGE_NOT_SATISFIABLE,
        "range-not-satisfiable",
        "The range lies outside the file",
    );
    let mut response = problem.detail(format!("the file has {size} bytes")).into_response();
    if let Ok(value) = HeaderValue::from_str(&format!("bytes */{size}")) {
        response.headers_mut().insert(header::CONTENT_RANGE, value);
    }
    response
}

#[derive(Debug, PartialEq, Eq)]
enum Requested {
    Whole,
    Part(Range<u64>),
    Unsatisfiable,
}

/// The bytes to send. A header that is not a single well-formed byte range is ignored, as RFC 9110 permits.
fn requested(headers: &HeaderMap, etag: &str, size: u64) -> Requested {
    let text = |name| headers.get(name).and_then(|v: &HeaderValue| v.to_str().ok());
    if text(header::IF_RANGE).is_some_and(|v| v != etag) {
        return Requested::Whole;
    }
    let spec = text(header::RANGE).and_then(|v| v.strip_prefix("bytes=")).and_then(|v| v.split_once('-'));
    let Some((first, last)) = spec else { return Requested::Whole };
    let range = match (first.trim().parse::<u64>(), last.trim()) {
        (Ok(first), "") => first..size,
        (Ok(first), last) => match last.parse::<u64>() {
            Ok(last) if last >= first => first..last.saturating_add(1).min(size),
            _ => return Requested::Whole,
        },
        (Err(_), last) if first.trim().is_empty() => match last.parse::<u64>() {
            Ok(count) => size.saturating_sub(count)..size,
            Err(_) => return Requested::Whole,
        },
        _ => return Requested::Whole,
    };
    if range.is_empty() { Requested::Unsatisfiable } else { Requested::Part(range) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ask(range: &str) -> Requested {
        let headers = HeaderMap::from_iter([(header::RANGE, HeaderValue::from_str(range).unwrap())]);
        requested(&headers, "\"e\"", 10)
    }

    #[test]
    fn byte_ranges_are_parsed_as_in_rfc_9110() {
        assert_eq!(ask("bytes=0-3"), Requested::Part(0..4));
        assert_eq!(ask("bytes=4-"), Requested::Part(4..10));
        assert_eq!(ask("bytes=-3"), Requested::Part(7..10));
        assert_eq!(ask("bytes=-30"), Requested::Part(0..10));
        assert_eq!(ask("bytes=8-99"), Requested::Part(8..10));
        assert_eq!(ask("bytes=10-"), Requested::Unsatisfiable);
        assert_eq!(ask("bytes=-0"), Requested::Unsatisfiable);
    }

    #[test]
    fn invalid_or_multiple_byte_ranges_are_ignored() {
        for odd in ["bytes=3-1", "bytes=a-b", "bytes=0-1,3-4", "lines=0-1", "bytes=--1", "bytes=-"] {
            assert_eq!(ask(odd), Requested::Whole, "{odd}");
        }
    }
}
