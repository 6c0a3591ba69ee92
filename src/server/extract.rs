//! Extractors whose errors are problems that name the field.

use std::error::Error;

use axum::body::Bytes;
use axum::extract::{FromRequest, FromRequestParts, Path, Query, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, StatusCode, header};
use http_body_util::LengthLimitError;
use serde::de::DeserializeOwned;
use serde_json::error::Category;
use serde_path_to_error::Segment;
use tower_http::timeout::TimeoutError;

use crate::server::app::AppState;
use crate::server::body_rate::BodyTooSlow;
use crate::server::memory::MemoryPermit;
use crate::server::nul;
use crate::server::problem::Problem;

/// A JSON body of at most `LIMIT` bytes.
pub(super) struct JsonBody<T, const LIMIT: usize = 65_536>(pub(super) T);

/// A JSON body of at most `LIMIT` bytes, with the permit for its memory until this is dropped.
pub(super) struct LargeJson<T, const LIMIT: usize>(pub(super) T, pub(super) MemoryPermit);

impl<T: DeserializeOwned, const LIMIT: usize> FromRequest<AppState> for LargeJson<T, LIMIT> {
    type Rejection = Problem;

    async fn from_request(request: Request, app: &AppState) -> Result<Self, Problem> {
        let length = content_length(request.headers()).unwrap_or(LIMIT as u64).min(LIMIT as u64);
        let permit = app.memory.reserve_body(length).await?;
        let bytes = json_bytes(request, LIMIT).await?;
        Ok(Self(parse(&bytes)?, permit))
    }
}

/// A query string.
pub(super) struct QueryString<T>(pub(super) T);

/// The query string of a route without parameters.
#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct NoQuery {}

/// The parameters of the path.
pub(super) struct UrlPath<T>(pub(super) T);

impl<S: Send + Sync, T: DeserializeOwned + Send> FromRequestParts<S> for UrlPath<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        match Path::<T>::from_request_parts(parts, state).await {
            Ok(Path(value)) => Ok(Self(value)),
            Err(rejection) => Err(Problem::new(
                StatusCode::BAD_REQUEST,
                "malformed-path",
                "The path of the URL cannot be read",
            )
            .detail(rejection.body_text())),
        }
    }
}

impl<S: Send + Sync, T: DeserializeOwned, const LIMIT: usize> FromRequest<S> for JsonBody<T, LIMIT> {
    type Rejection = Problem;

    async fn from_request(request: Request, _: &S) -> Result<Self, Problem> {
        let bytes = json_bytes(request, LIMIT).await?;
        parse(&bytes).map(Self)
    }
}

impl<S: Send + Sync, T: DeserializeOwned> FromRequestParts<S> for QueryString<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        match Query::<T>::try_from_uri(&parts.uri) {
            Ok(Query(value)) => Ok(Self(value)),
            Err(rejection) => {
                let text = rejection.body_text();
                let detail = text.rsplit_once("query string: ").map_or(text.as_str(), |(_, d)| d);
                // serde also quotes words that are not field names, e.g. the values of a boolean.
                let field = quoted(detail).filter(|_| detail.contains(" field `"));
                let name = field.or_else(|| detail.split_once(": ").map(|(name, _)| name));
                Err(Problem::invalid_field(format!("query/{}", name.unwrap_or_default()), detail))
            }
        }
    }
}

/// The declared length of a body.
pub(super) fn content_length(headers: &HeaderMap) -> Option<u64> {
    headers.get(header::CONTENT_LENGTH)?.to_str().ok()?.parse().ok()
}

/// The media type of a body without its parameters, in lower case.
pub(super) fn media_type(headers: &HeaderMap) -> Option<String> {
    let value = headers.get(header::CONTENT_TYPE)?.to_str().ok()?;
    Some(value.split(';').next()?.trim().to_ascii_lowercase())
}

async fn json_bytes(request: Request, limit: usize) -> Result<Bytes, Problem> {
    if !media_type(request.headers()).is_some_and(|m| m == "application/json" || m.ends_with("+json")) {
        return Err(Problem::unsupported_media_type("application/json"));
    }
    if content_length(request.headers()).is_some_and(|n| n > limit as u64) {
        return Err(Problem::too_large(limit as u64));
    }
    axum::body::to_bytes(request.into_body(), limit).await.map_err(|e| body_broken(&e, limit))
}

/// The problem of a body that was not received completely.
fn body_broken(error: &axum::Error, limit: usize) -> Problem {
    if caused_by::<LengthLimitError>(error) {
        return Problem::too_large(limit as u64);
    }
    if is_too_slow(error) {
        return Problem::timeout(STALLED);
    }
    Problem::new(StatusCode::BAD_REQUEST, "incomplete-body", "The body could not be read")
        .detail(error.to_string())
}

/// The detail for a body that stopped arriving.
pub(super) const STALLED: &str = "the rest of the body did not arrive in time";

/// Whether a body ended because the client did not send it in time.
pub(super) fn is_too_slow(error: &(dyn Error + 'static)) -> bool {
    caused_by::<TimeoutError>(error) || caused_by::<BodyTooSlow>(error)
}

/// Whether an error of type `E` is among the causes.
fn caused_by<E: Error + 'static>(error: &(dyn Error + 'static)) -> bool {
    std::iter::successors(Some(error), |e| (*e).source()).any(|e| e.is::<E>())
}

/// Parses JSON. An error contains the position in the document.
pub(super) fn parse<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Problem> {
    // Otherwise a list would be accepted as the fields of an object in order.
    if bytes.trim_ascii_start().first() == Some(&b'[') {
        return Err(Problem::invalid_field("", "must be an object"));
    }
    nul::check_json(bytes)?;
    let mut json = serde_json::Deserializer::from_slice(bytes);
    let value = serde_path_to_error::deserialize(&mut json).map_err(wrong_field)?;
    json.end().map_err(|error| malformed(&error))?;
    Ok(value)
}

/// Deserialises parsed JSON. An error contains the position in the document.
pub(super) fn read<T: DeserializeOwned>(json: serde_json::Value) -> Result<T, Problem> {
    serde_path_to_error::deserialize(json).map_err(wrong_field)
}

fn wrong_field(error: serde_path_to_error::Error<serde_json::Error>) -> Problem {
    let mut pointer = pointer(error.path());
    let inner = error.into_inner();
    if inner.classify() != Category::Data {
        return malformed(&inner);
    }
    let text = inner.to_string();
    if text.starts_with("missing field")
        && let Some(name) = quoted(&text)
    {
        pointer = format!("{pointer}/{name}");
    }
    Problem::invalid_field(pointer, text)
}

fn malformed(error: &serde_json::Error) -> Problem {
    Problem::new(StatusCode::BAD_REQUEST, "malformed-json", "The body is not JSON").detail(error.to_string())
}

/// JSON pointer of a field (RFC 6901).
pub(super) fn pointer_to(field: &str) -> String {
    format!("/{}", field.replace('~', "~0").replace('/', "~1"))
}

/// A JSON pointer (RFC 6901).
fn pointer(path: &serde_path_to_error::Path) -> String {
    path.iter()
        .map(|segment| match segment {
            Segment::Seq { index } => format!("/{index}"),
            Segment::Map { key } | Segment::Enum { variant: key } => pointer_to(key),
            Segment::Unknown => String::new(),
        })
        .collect()
}

/// The first name in backticks in a message of serde.
fn quoted(text: &str) -> Option<&str> {
    text.split('`').nth(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    #[allow(dead_code)]
    struct Outer {
        inner: Vec<Inner>,
    }
    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    #[allow(dead_code)]
    struct Inner {
        size: u32,
    }

    fn refusal(json: &str) -> (u16, String) {
        let problem = parse::<Outer>(json.as_bytes()).unwrap_err();
        (problem.status, problem.errors.first().map(|e| e.pointer.clone()).unwrap_or_default())
    }

    #[test]
    fn json_errors_point_to_the_invalid_field() {
        assert_eq!(refusal(r#"{"inner":[{"size":1},{"size":-1}]}"#), (422, "/inner/1/size".into()));
        assert_eq!(refusal(r#"{"inner":[{"size":1,"a/b":2}]}"#), (422, "/inner/0/a~1b".into()));
        assert_eq!(refusal(r#"{"inner":[{}]}"#), (422, "/inner/0/size".into()));
        assert_eq!(refusal(r#" [[{"size":1}]]"#), (422, String::new()), "a list is not an object");
        assert_eq!(refusal(r"{}"), (422, "/inner".into()));
    }

    #[test]
    fn malformed_json_answers_400() {
        for json in ["", "{", "{} {}", "{\"inner\":[]}x", "{\"inner\":[{\"size\":1e999}]}"] {
            assert_eq!(refusal(json).0, if json.starts_with("{} ") { 422 } else { 400 }, "{json}");
        }
    }
}
