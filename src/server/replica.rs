//! Replicas: additional servers of a database that answer, render and train, but leave some operations to the first server.

use axum::extract::{MatchedPath, Request};
use axum::http::{Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use crate::server::problem::Problem;

/// Operations of the first server only; without a method, all methods of a path. They store files, create files in the
/// background, or delete files.
const PRIMARY_ONLY: &[(Option<Method>, &str)] = &[
    (Some(Method::POST), "/v1/captures"),
    (Some(Method::DELETE), "/v1/captures/{id}"),
    (None, "/v1/captures/{id}/log"),
    (Some(Method::POST), "/v1/environments"),
    (Some(Method::DELETE), "/v1/environments/{id}"),
    (Some(Method::DELETE), "/v1/exports/{id}"),
    (Some(Method::DELETE), "/v1/jobs/{id}"),
    (Some(Method::DELETE), "/v1/models/{id}"),
    (None, "/v1/models/{id}/calibration"),
    (Some(Method::POST), "/v1/models/{id}/exports"),
    (None, "/v1/uploads"),
    (None, "/v1/uploads/{id}"),
];

fn is_primary_only(method: &Method, path: &str) -> bool {
    PRIMARY_ONLY.iter().any(|(of, route)| *route == path && of.as_ref().is_none_or(|of| of == method))
}

/// Refuses operations of the first server.
pub(super) async fn check(request: Request, next: Next) -> Response {
    let route = request.extensions().get::<MatchedPath>().map_or("", MatchedPath::as_str);
    if !is_primary_only(request.method(), route) {
        return next.run(request).await;
    }
    let title = "Only the first server supports this request";
    Problem::new(StatusCode::MISDIRECTED_REQUEST, "first-server-only", title)
        .detail("this server is a replica that reads, renders and trains; send uploads, exports, calibrations and deletions to the first server")
        .into_response()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::server::openapi;

    #[test]
    fn every_first_server_route_exists_in_the_api() {
        let description = serde_json::to_value(openapi()).unwrap();
        for (method, path) in PRIMARY_ONLY {
            let item = &description["paths"][path];
            let there =
                method.as_ref().map_or(item.is_object(), |m| item[m.as_str().to_lowercase()].is_object());
            assert!(there, "{method:?} {path}");
        }
    }

    #[test]
    fn replicas_serve_reads_renders_and_training() {
        assert!(is_primary_only(&Method::DELETE, "/v1/models/{id}"));
        assert!(is_primary_only(&Method::HEAD, "/v1/uploads/{id}"));
        for (method, path) in [
            (Method::GET, "/v1/models/{id}"),
            (Method::POST, "/v1/models/{id}/render"),
            (Method::POST, "/v1/jobs"),
            (Method::POST, "/v1/work/claims"),
        ] {
            assert!(!is_primary_only(&method, path), "{method} {path}");
        }
    }
}
