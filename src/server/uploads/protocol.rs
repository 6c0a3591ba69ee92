//! The tus protocol: its version check, and the headers of every answer.

use axum::extract::{Request, State};
use axum::http::{HeaderValue, Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use crate::server::problem::Problem;
use crate::server::uploads::headers::{ALGORITHMS, EXTENSION, MAX_SIZE, RESUMABLE, VERSION};

const PROTOCOL_VERSION: HeaderValue = HeaderValue::from_static("1.0.0");
const EXTENSIONS: HeaderValue =
    HeaderValue::from_static("creation,creation-with-upload,checksum,expiration,termination");
const CHECKSUMS: HeaderValue = HeaderValue::from_static("sha1,sha256");

/// Refuses requests of other versions. `GET` and `OPTIONS` need no version; `GET` is not part of the protocol.
pub(super) async fn check_version(request: Request, next: Next) -> Response {
    let needs_none = matches!(*request.method(), Method::GET | Method::OPTIONS);
    let mut response = match request.headers().get(RESUMABLE) {
        Some(version) if version == PROTOCOL_VERSION => next.run(request).await,
        None if needs_none => next.run(request).await,
        _ => {
            let title = "The version of the tus protocol is not supported";
            let problem = Problem::new(StatusCode::PRECONDITION_FAILED, "tus-version", title);
            let mut response = problem.detail("send the header Tus-Resumable: 1.0.0").into_response();
            response.headers_mut().insert(VERSION, PROTOCOL_VERSION);
            response
        }
    };
    response.headers_mut().insert(RESUMABLE, PROTOCOL_VERSION);
    response
}

/// Adds the supported extensions to answers to `OPTIONS`, including those of the CORS layer. `most` is the maximum size of an
/// upload.
pub(in crate::server) async fn advertise(State(most): State<u64>, request: Request, next: Next) -> Response {
    let is_asked = request.method() == Method::OPTIONS && request.uri().path() == "/v1/uploads";
    let mut response = next.run(request).await;
    if is_asked {
        let headers = response.headers_mut();
        let most = HeaderValue::from(most);
        for (name, value) in [
            (RESUMABLE, PROTOCOL_VERSION),
            (VERSION, PROTOCOL_VERSION),
            (EXTENSION, EXTENSIONS),
            (MAX_SIZE, most),
            (ALGORITHMS, CHECKSUMS),
        ] {
            headers.insert(name, value);
        }
    }
    response
}
