//! The middleware of all routes: request identifiers, headers, origins, keys and limits, in order.

use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body, Bytes, HttpBody};
use axum::error_handling::HandleErrorLayer;
use axum::extract::{DefaultBodyLimit, Request};
use axum::http::{HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::Response;
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
use crate::server::same_site::{self, TrustedHosts};
use crate::server::tenant_slots::{self, TenantSlots};
use crate::server::{body_rate, nul, replica, telemetry, uploads};

/// The content security policy of the API, whose answers may load, run and frame nothing. Pages have their own policy.
const NOT_A_PAGE: &str = "default-src 'none'; frame-ancestors 'none'";

/// The configuration of the middleware.
pub(super) struct MiddlewareConfig {
    pub(super) access_control: Arc<AccessControl>,
    /// Whether the server is a replica.
    pub(super) is_replica: bool,
    /// Whether the server starts without keys. Keys may be created while it runs; the checks of host and origin remain active.
    pub(super) is_open: bool,
    pub(super) origins: Vec<CorsOrigin>,
    pub(super) hosts: TrustedHosts,
    /// Timeout between two chunks of a request's body.
    pub(super) body_stall: Duration,
    /// Minimum rate of a request's body, bytes per second.
    pub(super) body_rate: u64,
    /// Maximum bytes of a resumable upload.
    pub(super) most_uploaded: u64,
}

/// Limits of a group of routes.
pub(super) struct RouteLimits {
    /// Maximum number of concurrent requests; further requests are refused.
    max_concurrent: usize,
    /// Maximum number of concurrent requests per tenant, if there are keys.
    per_tenant: usize,
    /// Timeout from the head of a request to the head of its answer.
    timeout: Duration,
}

/// Uploads: limited by their rate and by the time between two chunks, so that gigabytes may take hours.
pub(super) const UPLOADS: RouteLimits =
    RouteLimits { max_concurrent: 64, per_tenant: 32, timeout: Duration::from_secs(24 * 3600) };
/// Files that remote workers receive and send, separate from uploads, so that slow uploads cannot stop trainings.
pub(super) const WORKER_FILES: RouteLimits =
    RouteLimits { max_concurrent: 256, per_tenant: 256, timeout: Duration::from_secs(24 * 3600) };
/// Lists that are read from archives, separate from uploads, so that slow uploads cannot stop them.
pub(super) const ARCHIVE_READS: RouteLimits =
    RouteLimits { max_concurrent: 64, per_tenant: 32, timeout: Duration::from_secs(300) };
/// Renders: the body, the queue of the device, and the frame.
pub(super) const RENDERS: RouteLimits =
    RouteLimits { max_concurrent: 128, per_tenant: 128, timeout: Duration::from_secs(300) };
/// Thumbnails, separate from renders, so that neither can use all slots of the other.
pub(super) const THUMBNAILS: RouteLimits =
    RouteLimits { max_concurrent: 256, per_tenant: 256, timeout: Duration::from_secs(300) };
/// All other routes, with small bodies and queries: as many as there are connections by default.
pub(super) const QUERIES: RouteLimits =
    RouteLimits { max_concurrent: 4096, per_tenant: 4096, timeout: Duration::from_secs(60) };

/// Applies limits to a group of routes. Requests beyond them are refused immediately.
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

/// Applies the middleware to all routes. The layers run from the first to the last.
pub(super) fn with_middleware(routes: Router<AppState>, config: MiddlewareConfig) -> Router<AppState> {
    let MiddlewareConfig { access_control, is_replica, is_open, origins, hosts, .. } = config;
    // A key, which foreign pages do not know, gives the same protection as the checks of host and origin.
    let csrf = is_open.then(|| same_site::csrf(&origins));
    let host = is_open.then(|| middleware::from_fn_with_state(hosts, same_site::check_host));
    routes.layer(
        ServiceBuilder::new()
            .layer(middleware::from_fn(telemetry::instrument))
            .layer(middleware::from_fn(without_false_length))
            .layer(fixed(header::X_CONTENT_TYPE_OPTIONS, "nosniff"))
            .layer(fixed(header::REFERRER_POLICY, "no-referrer"))
            .layer(unless_set(header::CONTENT_SECURITY_POLICY, NOT_A_PAGE))
            .layer(CatchPanicLayer::custom(telemetry::on_panic))
            .layer(middleware::from_fn(nul::check_url))
            .option_layer(host)
            // Outside CORS, because that layer answers every OPTIONS itself.
            .layer(middleware::from_fn_with_state(config.most_uploaded, uploads::advertise))
            // Outside authentication, because the preflight request of a browser has no key.
            .option_layer(origins::cors(&origins))
            .option_layer(csrf)
            .layer(middleware::from_fn_with_state(access_control, access::check))
            .option_layer(is_replica.then(|| middleware::from_fn(replica::check)))
            .layer(middleware::from_fn_with_state(config.body_rate, body_rate::limit))
            .layer(RequestBodyTimeoutLayer::new(config.body_stall))
            // Each body extractor has its own limit.
            .layer(DefaultBodyLimit::disable()),
    )
}

fn unless_set(name: HeaderName, value: &'static str) -> SetResponseHeaderLayer<HeaderValue> {
    SetResponseHeaderLayer::if_not_present(name, HeaderValue::from_static(value))
}

fn fixed(name: HeaderName, value: &'static str) -> SetResponseHeaderLayer<HeaderValue> {
    SetResponseHeaderLayer::overriding(name, HeaderValue::from_static(value))
}

/// Removes the length of empty answers to `HEAD`. A handler that makes no body for `HEAD` does not know the length that `GET`
/// would have, but axum would state the length 0 of the empty body. `HEAD` must state the length of `GET` or none (RFC 9110,
/// section 8.6).
async fn without_false_length(request: Request, next: Next) -> Response {
    let is_head = request.method() == Method::HEAD;
    let response = next.run(request).await;
    let is_empty = response.body().size_hint().exact() == Some(0);
    match is_head && is_empty && !response.headers().contains_key(header::CONTENT_LENGTH) {
        // The length of a stream is unknown. axum removes the body itself.
        true => response.map(|_| Body::from_stream(futures::stream::empty::<Result<Bytes, BoxError>>())),
        false => response,
    }
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
    use axum::response::IntoResponse;
    use axum::routing::get;
    use tokio::sync::Notify;
    use tower::ServiceExt;

    /// Two routes of one group that answer when notified.
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

    #[tokio::test]
    async fn head_without_a_body_states_no_length() {
        let body = |method: Method| async move { if method == Method::HEAD { "" } else { "whole" } };
        let sized = || async { ([(header::CONTENT_LENGTH, "0")], "").into_response() };
        let routes = Router::new().route("/left-out", get(body)).route("/made", get(|| async { "whole" }));
        let routes = routes.route("/sized", get(sized));
        let length = async |routes: Router, method: Method, path: &str| {
            let request = Request::builder().method(method).uri(path).body(Body::empty()).unwrap();
            let response = routes.oneshot(request).await.unwrap();
            let length = response.headers().get(header::CONTENT_LENGTH)?;
            Some(length.to_str().unwrap().to_owned())
        };
        let bare = routes.clone();
        assert_eq!(length(bare, Method::HEAD, "/left-out").await.as_deref(), Some("0"), "the control");
        let routes = routes.layer(middleware::from_fn(without_false_length));
        for (method, path, wanted) in [
            (Method::HEAD, "/left-out", None),
            (Method::GET, "/left-out", Some("5")),
            (Method::HEAD, "/made", Some("5")),
            (Method::GET, "/made", Some("5")),
            (Method::HEAD, "/sized", Some("0")),
        ] {
            assert_eq!(length(routes.clone(), method, path).await.as_deref(), wanted, "{path}");
        }
    }
}
