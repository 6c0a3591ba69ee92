//! What stands before every handler, in one place: the order in which a request meets identifiers, headers, origins, keys
//! and bounds.

use std::sync::Arc;
use std::time::Duration;

use axum::error_handling::HandleErrorLayer;
use axum::extract::DefaultBodyLimit;
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::{BoxError, Router, middleware};
use tower::ServiceBuilder;
use tower::limit::GlobalConcurrencyLimitLayer;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::set_header::SetResponseHeaderLayer;
use tower_http::timeout::RequestBodyTimeoutLayer;
use utoipa_axum::router::OpenApiRouter;

use crate::server::access::{self, AccessControl};
use crate::server::app::AppState;
use crate::server::origins::{self, CorsOrigin};
use crate::server::problem::Problem;
use crate::server::replica;
use crate::server::same_site::{self, TrustedHosts};
use crate::server::telemetry;
use crate::server::tenant_slots::{self, TenantSlots};
use crate::server::uploads;

/// What the API sends is no page: it may load, run and frame nothing. Pages bring a policy of their own.
const NOT_A_PAGE: &str = "default-src 'none'; frame-ancestors 'none'";

/// What a server's stack depends on.
pub(super) struct MiddlewareConfig {
    pub(super) access_control: Arc<AccessControl>,
    /// Whether another server is the first.
    pub(super) is_replica: bool,
    /// Whether the server begins without keys. It may get some while it runs; the checks of host and origin stay.
    pub(super) is_open: bool,
    pub(super) origins: Vec<CorsOrigin>,
    pub(super) hosts: TrustedHosts,
    /// Between two pieces of a request's body.
    pub(super) body_stall: Duration,
    /// Bytes of the largest upload in pieces.
    pub(super) most_uploaded: u64,
}

/// How much of one kind of work is taken on.
pub(super) struct RouteLimits {
    /// Requests in progress; one more is turned away.
    max_concurrent: usize,
    /// The same of one tenant, where there are keys.
    per_tenant: usize,
    /// From a request's head to the head of its answer.
    timeout: Duration,
}

/// Uploads: bound by the time between two pieces, so that gigabytes may take hours.
pub(super) const UPLOADS: RouteLimits =
    RouteLimits { max_concurrent: 64, per_tenant: 32, timeout: Duration::from_secs(24 * 3600) };
/// Renders: the body, the device's queue, the frame.
pub(super) const RENDERS: RouteLimits =
    RouteLimits { max_concurrent: 128, per_tenant: 128, timeout: Duration::from_secs(300) };
/// Thumbnails, apart from renders so that neither takes the other's slots.
pub(super) const THUMBNAILS: RouteLimits =
    RouteLimits { max_concurrent: 256, per_tenant: 256, timeout: Duration::from_secs(300) };
/// Everything else: small bodies and queries; as many as there are connections by default.
pub(super) const QUERIES: RouteLimits =
    RouteLimits { max_concurrent: 4096, per_tenant: 4096, timeout: Duration::from_secs(60) };

/// Around the routes of one kind: requests beyond the bounds are turned away at once, none waits for a place.
pub(super) fn with_limits<S>(routes: OpenApiRouter<S>, bounds: &RouteLimits) -> OpenApiRouter<S>
where
    S: Clone + Send + Sync + 'static,
{
    routes.layer(
        ServiceBuilder::new()
            .layer(middleware::from_fn_with_state(
                TenantSlots::new(bounds.per_tenant),
                tenant_slots::limit_per_tenant,
            ))
            .layer(HandleErrorLayer::new(out_of_bounds))
            .load_shed()
            .layer(GlobalConcurrencyLimitLayer::new(bounds.max_concurrent))
            .timeout(bounds.timeout),
    )
}

/// Around all routes. Layers run from the first to the last.
pub(super) fn with_middleware(routes: Router<AppState>, config: MiddlewareConfig) -> Router<AppState> {
    let MiddlewareConfig { access_control, is_replica, is_open, origins, hosts, body_stall, most_uploaded } =
        config;
    // A key, which no foreign page knows, protects as well as the checks of host and origin.
    let csrf = is_open.then(|| same_site::csrf(&origins));
    let host = is_open.then(|| middleware::from_fn_with_state(hosts, same_site::check_host));
    routes.layer(
        ServiceBuilder::new()
            .layer(middleware::from_fn(telemetry::instrument))
            .layer(fixed(header::X_CONTENT_TYPE_OPTIONS, "nosniff"))
            .layer(fixed(header::REFERRER_POLICY, "no-referrer"))
            .layer(unless_set(header::CONTENT_SECURITY_POLICY, NOT_A_PAGE))
            .layer(CatchPanicLayer::custom(telemetry::on_panic))
            .option_layer(host)
            // Outside CORS, which answers every OPTIONS by itself.
            .layer(middleware::from_fn_with_state(most_uploaded, uploads::advertise))
            // Outside authentication: a browser's preflight carries no key.
            .option_layer(origins::cors(&origins))
            .option_layer(csrf)
            .layer(middleware::from_fn_with_state(access_control, access::check))
            .option_layer(is_replica.then(|| middleware::from_fn(replica::check)))
            .layer(RequestBodyTimeoutLayer::new(body_stall))
            // Every extractor of bodies brings its own limit.
            .layer(DefaultBodyLimit::disable()),
    )
}

fn unless_set(name: HeaderName, value: &'static str) -> SetResponseHeaderLayer<HeaderValue> {
    SetResponseHeaderLayer::if_not_present(name, HeaderValue::from_static(value))
}

fn fixed(name: HeaderName, value: &'static str) -> SetResponseHeaderLayer<HeaderValue> {
    SetResponseHeaderLayer::overriding(name, HeaderValue::from_static(value))
}

async fn out_of_bounds(error: BoxError) -> Problem {
    if error.is::<tower::load_shed::error::Overloaded>() {
        let title = "Too many requests of this kind are in progress";
        let detail = "the limit applies to all tenants together";
        return Problem::new(StatusCode::SERVICE_UNAVAILABLE, "busy", title).detail(detail).retry_after(1);
    }
    if error.is::<tower::timeout::error::Elapsed>() {
        return Problem::timeout("the server did not complete the request in time");
    }
    Problem::internal(error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::body::Body;
    use axum::extract::Request;
    use axum::response::Response;
    use axum::routing::get;
    use tokio::sync::Notify;
    use tower::ServiceExt;

    /// Two routes of one kind that answer when they are told to.
    fn routes(bounds: &RouteLimits) -> (Router, Arc<Notify>) {
        let go = Arc::new(Notify::new());
        let told = go.clone();
        let handler = get(move || async move { told.notified().await });
        let routes = OpenApiRouter::new().route("/a", handler.clone()).route("/b", handler);
        (with_limits(routes, bounds).split_for_parts().0, go)
    }

    fn ask(router: &Router, path: &str) -> impl Future<Output = Response> + use<> {
        let request = Request::get(path).body(Body::empty()).unwrap();
        let router = router.clone();
        async move { router.oneshot(request).await.unwrap() }
    }

    #[tokio::test]
    async fn requests_over_the_concurrency_limit_answer_503_at_once() {
        let (router, go) =
            routes(&RouteLimits { max_concurrent: 1, per_tenant: 1, timeout: Duration::from_secs(600) });
        let mut first = Box::pin(ask(&router, "/a"));
        assert!(futures::poll!(&mut first).is_pending());
        let refused = ask(&router, "/b").await;
        assert_eq!(refused.status(), StatusCode::SERVICE_UNAVAILABLE);
        assert_eq!(refused.headers()[header::RETRY_AFTER], "1");
        assert_eq!(refused.headers()[header::CONTENT_TYPE], "application/problem+json");
        go.notify_one();
        assert_eq!(first.await.status(), StatusCode::OK);
        go.notify_one();
        assert_eq!(ask(&router, "/b").await.status(), StatusCode::OK);
    }

    #[tokio::test(start_paused = true)]
    async fn a_request_over_the_time_limit_answers_408() {
        let (router, _go) =
            routes(&RouteLimits { max_concurrent: 1, per_tenant: 1, timeout: Duration::from_secs(5) });
        assert_eq!(ask(&router, "/a").await.status(), StatusCode::REQUEST_TIMEOUT);
    }
}
