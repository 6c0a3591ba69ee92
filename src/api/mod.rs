//! The HTTP service: one file an endpoint family, each with its own routes, documentation and refusals.

// A refusal is made once a request; what it costs to move is nothing beside the request itself.
#![allow(clippy::result_large_err)]

pub mod auth;
pub mod captures;
mod description;
pub mod environments;
mod events;
mod extract;
mod files;
mod health;
pub mod jobs;
pub mod listing;
pub mod models;
mod observe;
pub mod picture;
pub mod problem;
pub mod renders;
pub mod server;
pub mod thumbnails;
mod upload;

use std::sync::Arc;

use axum::http::{HeaderValue, Method, StatusCode, Uri};
use axum::{Router, middleware};
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::cors::{AllowHeaders, AllowMethods, CorsLayer};
use utoipa_axum::router::OpenApiRouter;

pub use observe::REQUEST_ID;
pub use problem::Problem;

use crate::jobs::Jobs;
use crate::store::Store;
use crate::worker::Device;
use auth::ApiKeys;

/// What handlers share.
type Shared = Arc<App>;

/// Bounds on what a request may bring.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Bytes of a capture archive.
    pub capture_bytes: u64,
    /// Bytes of an environment file.
    pub environment_bytes: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { capture_bytes: 16 << 30, environment_bytes: 256 << 20 }
    }
}

/// The state behind the routes.
struct App {
    store: Store,
    jobs: Jobs,
    device: Device,
    limits: Limits,
    /// Turns for work that needs much memory.
    imports: Semaphore,
    /// Cancelled when the server begins to shut down.
    stop: CancellationToken,
    /// True when no API key is asked for.
    is_open: bool,
}

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
pub fn openapi() -> utoipa::openapi::OpenApi {
    description::with_short_defaults(description::with_problems(families().split_for_parts().1))
}

/// The whole service. Layers run from the last to the first.
fn router(app: Shared, keys: ApiKeys, origins: &[HeaderValue]) -> Router {
    let routes = families()
        .split_for_parts()
        .0
        .method_not_allowed_fallback(method_not_allowed)
        .fallback(no_such_path)
        // Every extractor of bodies brings its own limit.
        .layer(axum::extract::DefaultBodyLimit::disable())
        .layer(middleware::from_fn_with_state(keys, auth::authenticate));
    // Outside authentication: a browser's preflight carries no key.
    let routes = if origins.is_empty() { routes } else { routes.layer(cors(origins)) };
    routes
        .layer(CatchPanicLayer::custom(observe::on_panic))
        .layer(middleware::from_fn(observe::observe))
        .with_state(app)
}

/// Lets pages of the listed origins in, and no others.
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
