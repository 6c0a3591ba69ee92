//! Idempotent requests that queue something: the header `Idempotency-Key`.

use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use sha2::{Digest, Sha256};

use crate::server::problem::Problem;
use crate::store::{IdempotencyKey, hex};

const IDEMPOTENCY_KEY: HeaderName = HeaderName::from_static("idempotency-key");
const REPLAYED: HeaderName = HeaderName::from_static("idempotent-replayed");

/// The key, with a hash of the parsed request, so that white space does not matter.
///
/// # Errors
/// 422 for an invalid key.
pub(super) fn key(headers: &HeaderMap, request: &impl Serialize) -> Result<Option<IdempotencyKey>, Problem> {
    let Some(value) = headers.get(IDEMPOTENCY_KEY) else { return Ok(None) };
    let key = value.to_str().ok().filter(|k| (1..=255).contains(&k.len()));
    let wrong = || Problem::invalid_field("header/Idempotency-Key", "must have 1 to 255 visible characters");
    let body = serde_json::to_vec(request).map_err(Problem::internal)?;
    Ok(Some(IdempotencyKey {
        key: key.ok_or_else(wrong)?.to_owned(),
        fingerprint: hex(&Sha256::digest(&body)),
    }))
}

/// The answer `text` with the `id` of a resource below `path`, which was queued now or by an earlier request with the same key.
pub(super) fn accepted(text: String, replayed: bool, path: &str) -> Result<Response, Problem> {
    let json = HeaderValue::from_static("application/json");
    let thing: serde_json::Value = serde_json::from_str(&text).map_err(Problem::internal)?;
    let location = format!("{path}/{}", thing["id"].as_str().unwrap_or_default());
    let location = HeaderValue::from_str(&location).map_err(Problem::internal)?;
    let headers = [(header::CONTENT_TYPE, json), (header::LOCATION, location)];
    let mut response = (StatusCode::ACCEPTED, headers, text).into_response();
    if replayed {
        response.headers_mut().insert(REPLAYED, HeaderValue::from_static("true"));
    }
    Ok(response)
}
