//! All routes.

use axum::Router;
use axum::http::{HeaderMap, Method, StatusCode, Uri};
use axum::response::{IntoResponse, Response};
use utoipa::openapi::OpenApi;
use utoipa_axum::router::OpenApiRouter;

use crate::server::app::AppState;
use crate::server::middleware::{
    self, ARCHIVE_READS, MiddlewareConfig, QUERIES, RENDERS, THUMBNAILS, UPLOADS, WORKER_FILES, with_limits,
};
use crate::server::problem::Problem;
#[cfg(feature = "web")]
use crate::server::web;
use crate::server::{
    calibrations, cameras, captures, deletion, description, environments, events, exports, files, health,
    jobs, keys, materials, models, next_photographs, photographs, poses, previews, renders, share_page,
    signed_urls, thumbnails, uploads, usage, viewer, webhooks, workers,
};

fn families() -> OpenApiRouter<AppState> {
    let receiving = captures::uploads().merge(environments::uploads()).merge(uploads::uploads());
    let reading = cameras::routes().merge(photographs::lists()).merge(poses::routes());
    let queries = captures::routes()
        .merge(environments::routes())
        .merge(jobs::routes())
        .merge(events::routes())
        .merge(keys::routes())
        .merge(signed_urls::routes())
        .merge(share_page::routes())
        .merge(models::routes())
        .merge(files::routes())
        .merge(materials::routes())
        .merge(exports::routes())
        .merge(deletion::routes())
        .merge(uploads::routes())
        .merge(usage::routes())
        .merge(webhooks::routes())
        .merge(workers::routes());
    OpenApiRouter::with_openapi(description::preamble())
        .merge(with_limits(receiving, &UPLOADS))
        .merge(with_limits(reading, &ARCHIVE_READS))
        .merge(with_limits(workers::transfers(), &WORKER_FILES))
        .merge(with_limits(queries, &QUERIES))
        .merge(with_limits(
            renders::routes().merge(calibrations::routes()).merge(next_photographs::routes()),
            &RENDERS,
        ))
        .merge(with_limits(
            thumbnails::routes()
                .merge(photographs::pictures())
                .merge(materials::pictures())
                .merge(previews::routes())
                .merge(viewer::routes()),
            &THUMBNAILS,
        ))
        // Without limits, so that health checks are answered under any load.
        .merge(health::routes())
}

/// The OpenAPI description of the API.
pub fn openapi() -> OpenApi {
    description::with_short_defaults(description::with_problems(families().split_for_parts().1))
}

/// The whole service.
pub(super) fn router(app: AppState, config: MiddlewareConfig) -> Router {
    let routes = families().split_for_parts().0;
    #[cfg(feature = "web")]
    let routes = routes.merge(web::routes());
    let routes = routes.method_not_allowed_fallback(method_not_allowed).fallback(no_such_path);
    middleware::with_middleware(routes, config).with_state(app)
}

async fn no_such_path(method: Method, uri: Uri, headers: HeaderMap) -> Response {
    #[cfg(feature = "web")]
    if let Some(redirection) = web::redirect(&method, &uri, &headers) {
        return redirection;
    }
    #[cfg(not(feature = "web"))]
    let _ = (method, headers);
    Problem::not_found("path", uri.path()).into_response()
}

async fn method_not_allowed(method: Method, uri: Uri) -> Problem {
    Problem::new(StatusCode::METHOD_NOT_ALLOWED, "method-not-allowed", "The method is not allowed")
        .detail(format!("{} does not support {method}", uri.path()))
}
