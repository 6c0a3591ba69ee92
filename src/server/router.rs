//! All routes and the layers around them.

use axum::extract::DefaultBodyLimit;
use axum::http::{HeaderValue, Method, StatusCode, Uri};
use axum::{Router, middleware};
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::cors::{AllowHeaders, AllowMethods, CorsLayer};
use utoipa::openapi::OpenApi;
use utoipa_axum::router::OpenApiRouter;

use crate::api::Problem;
use crate::server::app::Shared;
use crate::server::auth::{self, ApiKeys};
use crate::server::{
    captures, description, environments, events, files, health, jobs, models, observe, renders, thumbnails,
};

fn families() -> OpenApiRouter<Shared> {
    OpenApiRouter::with_openapi(description::preamble())
        .merge(captures::routes())
        .merge(environments::routes())
        .merge(jobs::routes())
        .merge(events::routes())
        .merge(models::routes())
        .merge(files::routes())
        .merge(renders::routes())
        .merge(thumbnails::routes())
        .merge(health::routes())
}

/// The description of the API.
pub fn openapi() -> OpenApi {
    description::with_short_defaults(description::with_problems(families().split_for_parts().1))
}

/// The whole service. Layers run from the last to the first.
pub(super) fn router(app: Shared, keys: ApiKeys, origins: &[HeaderValue]) -> Router {
    let routes = families()
        .split_for_parts()
        .0
        .method_not_allowed_fallback(method_not_allowed)
        .fallback(no_such_path)
        // Every extractor of bodies brings its own limit.
        .layer(DefaultBodyLimit::disable())
        .layer(middleware::from_fn_with_state(keys, auth::authenticate));
    // Outside authentication: a browser's preflight carries no key.
    let routes = if origins.is_empty() { routes } else { routes.layer(cors(origins)) };
    routes
        .layer(CatchPanicLayer::custom(observe::on_panic))
        .layer(middleware::from_fn(observe::observe))
        .with_state(app)
}

/// Lets pages of the listed origins call the API, and no others.
fn cors(origins: &[HeaderValue]) -> CorsLayer {
    CorsLayer::new()
        .allow_origin(origins.to_vec())
        .allow_methods(AllowMethods::list([Method::GET, Method::POST, Method::PATCH]))
        .allow_headers(AllowHeaders::mirror_request())
}

async fn no_such_path(uri: Uri) -> Problem {
    Problem::not_found("path", uri.path())
}

async fn method_not_allowed(method: Method, uri: Uri) -> Problem {
    Problem::new(StatusCode::METHOD_NOT_ALLOWED, "method-not-allowed", "The method is not allowed here")
        .detail(format!("{} does not take {method}", uri.path()))
}
