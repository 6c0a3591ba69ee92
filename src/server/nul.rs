//! Refuses NUL characters in requests. PostgreSQL cannot store them, so a request that has one would fail there and succeed on
//! SQLite.

use std::borrow::Cow;

use axum::extract::Request;
use axum::http::{StatusCode, Uri};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use percent_encoding::percent_decode_str;
use serde_json::Value;

use crate::server::extract::pointer_to;
use crate::server::problem::Problem;
use relume_api::problem::FieldError;

const DETAIL: &str = "contains a NUL character, which is not allowed; leave it out";

/// Refuses requests whose path or query string has a NUL, or whose path is not UTF-8.
pub(super) async fn check_url(request: Request, next: Next) -> Response {
    match fault_of_url(request.uri()) {
        Some(problem) => problem.into_response(),
        None => next.run(request).await,
    }
}

fn fault_of_url(uri: &Uri) -> Option<Problem> {
    let Some(path) = decoded(uri.path()) else {
        let title = "The path of the URL cannot be read";
        let detail = "path: is not UTF-8 after percent-decoding; correct it";
        return Some(Problem::new(StatusCode::BAD_REQUEST, "malformed-path", title).detail(detail));
    };
    if path.contains('\0') {
        return Some(refusal("path"));
    }
    let pairs = uri.query()?.split('&').map(|pair| pair.split_once('=').unwrap_or((pair, "")));
    let has_nul = |text: &str| text.contains("%00") || text.contains('\0');
    let (name, _) = pairs.into_iter().find(|(name, value)| has_nul(name) || has_nul(value))?;
    let name = decoded(name).unwrap_or_default().replace('\0', "\u{fffd}");
    Some(refusal(&format!("query/{name}")))
}

/// A percent-decoded text; `None` if it is not UTF-8.
fn decoded(text: &str) -> Option<String> {
    percent_decode_str(text).decode_utf8().ok().map(Cow::into_owned)
}

/// 400, which names the field.
pub(super) fn refusal(pointer: &str) -> Problem {
    let title = "A value contains a NUL character";
    let mut problem =
        Problem::new(StatusCode::BAD_REQUEST, "nul-character", title).detail(format!("{pointer}: {DETAIL}"));
    problem.errors.push(FieldError { pointer: pointer.to_owned(), detail: DETAIL.to_owned() });
    problem
}

/// Refuses a JSON document with a NUL in a text or key. A document that is not JSON passes; its parser refuses it.
pub(super) fn check_json(bytes: &[u8]) -> Result<(), Problem> {
    // JSON has a NUL only as this escape.
    const ESCAPE: &[u8] = b"\\u0000";
    if !bytes.windows(ESCAPE.len()).any(|window| window == ESCAPE) {
        return Ok(());
    }
    let Ok(document) = serde_json::from_slice(bytes) else { return Ok(()) };
    nul_in(&document).map_or(Ok(()), |pointer| Err(refusal(&pointer)))
}

/// JSON pointer of the first text or key with a NUL.
fn nul_in(value: &Value) -> Option<String> {
    match value {
        Value::String(text) => text.contains('\0').then(String::new),
        Value::Array(items) => {
            items.iter().enumerate().find_map(|(i, item)| Some(format!("/{i}{}", nul_in(item)?)))
        }
        Value::Object(fields) => fields.iter().find_map(|(name, field)| {
            let below = if name.contains('\0') { String::new() } else { nul_in(field)? };
            Some(format!("{}{below}", pointer_to(&name.replace('\0', "\u{fffd}"))))
        }),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The field that is refused.
    fn refused_in(uri: &str) -> Option<(String, Option<String>)> {
        let problem = fault_of_url(&uri.parse().unwrap())?;
        assert_eq!(problem.status, 400);
        let kind = problem.kind.rsplit(':').next().unwrap().to_owned();
        Some((kind, problem.errors.first().map(|error| error.pointer.clone())))
    }

    #[test]
    fn a_nul_in_a_url_is_refused_by_its_field() {
        let nul = |field: &str| Some(("nul-character".to_owned(), Some(field.to_owned())));
        assert_eq!(refused_in("/v1/jobs/a%00b"), nul("path"));
        assert_eq!(refused_in("/v1/jobs?limit=2&label=a%00"), nul("query/label"));
        assert_eq!(refused_in("/v1/jobs/%ED%A0%80"), Some(("malformed-path".to_owned(), None)));
        for sound in
            ["/v1/jobs/a%01b", "/v1/jobs?label=%2500", "/v1/captures/x/photographs/gr%C3%B6%C3%9Fe.png"]
        {
            assert_eq!(refused_in(sound), None, "the control: {sound}");
        }
    }

    #[test]
    fn a_nul_in_json_is_refused_by_its_field() {
        let place =
            |json: &str| check_json(json.as_bytes()).err().map(|problem| problem.errors[0].pointer.clone());
        assert_eq!(place(r#"{"a": [1, {"b": "x\u0000"}]}"#).as_deref(), Some("/a/1/b"));
        assert_eq!(place(r#"{"a\u0000": null}"#).as_deref(), Some("/a\u{fffd}"));
        for sound in [r#"{"a": "\\u0000"}"#, r#"{"a": "\u0001", "b": [true, 1.5, -2, null]}"#, "{\"\\u0000"] {
            assert_eq!(place(sound), None, "the control: {sound}");
        }
    }
}
