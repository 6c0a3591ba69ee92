//! Instrumentation of requests: identifiers, log lines, metrics, and conversion of panics into problems.

use std::any::Any;
use std::sync::OnceLock;
use std::time::Instant;

use axum::extract::{MatchedPath, Request};
use axum::http::{HeaderName, HeaderValue};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use metrics_exporter_prometheus::{PrometheusBuilder, PrometheusHandle};
use tracing::Instrument;

use crate::server::problem::Problem;
use crate::traces::{self, TraceParent};

/// The header with the request's identifier, in requests and answers.
pub(super) const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");

/// The context of the request that is being answered.
struct RequestContext {
    id: String,
    /// The parent span for work on the request, if it belongs to a trace.
    parent: Option<TraceParent>,
}

tokio::task_local! {
    static CURRENT: RequestContext;
}

/// The identifier of the current request; empty outside of a request.
pub(super) fn request_id() -> String {
    CURRENT.try_with(|current| current.id.clone()).unwrap_or_default()
}

/// The parent span for work that the current request causes, as a W3C `traceparent`: the span of the request, or that of the
/// caller if no spans are sent. `None` if it belongs to no trace.
pub(super) fn traceparent() -> Option<String> {
    CURRENT.try_with(|current| current.parent.as_ref().map(ToString::to_string)).ok().flatten()
}

/// Assigns an identifier and a span to the request, and counts it.
pub(super) async fn instrument(request: Request, next: Next) -> Response {
    let id = accepted_id(&request).unwrap_or_else(|| uuid::Uuid::now_v7().to_string());
    let method = request.method().clone();
    let path = request.extensions().get::<MatchedPath>();
    let route = path.map_or("unmatched", MatchedPath::as_str).to_owned();
    // The access control sets these fields.
    let (key, tenant) = (tracing::field::Empty, tracing::field::Empty);
    let span = tracing::info_span!("request", id, %method, route, key, tenant);
    let caller = caller_span(&request);
    if let Some(caller) = &caller {
        traces::link_parent(&span, caller);
    }
    let started = Instant::now();
    let id_header = HeaderValue::from_str(&id).ok();
    let current = RequestContext { id, parent: traces::as_parent(&span).or(caller) };
    let mut response = CURRENT.scope(current, next.run(request).instrument(span.clone())).await;
    let seconds = started.elapsed().as_secs_f64();
    let status = response.status().as_u16();
    traces::record_status(&span, status);
    span.in_scope(|| tracing::info!(status, seconds, "answered"));
    record(method.as_str(), route, status, seconds);
    if let Some(id) = id_header {
        response.headers_mut().insert(REQUEST_ID, id);
    }
    response
}

/// The caller's own identifier, if it is short and has only characters that are safe in logs.
fn accepted_id(request: &Request) -> Option<String> {
    let id = request.headers().get(REQUEST_ID)?.to_str().ok()?;
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    (!id.is_empty() && id.len() <= 64 && id.chars().all(plain)).then(|| id.to_owned())
}

/// The caller's span from a valid `traceparent`. Several such headers are ambiguous and ignored.
fn caller_span(request: &Request) -> Option<TraceParent> {
    let mut headers = request.headers().get_all(traces::HEADER).iter();
    let first = headers.next()?;
    if headers.next().is_some() { None } else { TraceParent::parse(first.to_str().ok()?) }
}

/// Labels have values from fixed lists, so that clients cannot add time series.
fn record(method: &str, route: String, status: u16, seconds: f64) {
    let method = match method {
        "GET" | "HEAD" | "POST" | "PUT" | "PATCH" | "DELETE" | "OPTIONS" => method.to_owned(),
        _ => "other".to_owned(),
    };
    let labels = [("method", method), ("route", route.clone()), ("status", status.to_string())];
    metrics::counter!("relume_http_requests_total", &labels).increment(1);
    metrics::histogram!("relume_http_request_seconds", "route" => route).record(seconds);
}

/// Converts a panic in a handler into a problem.
pub(super) fn on_panic(panic: Box<dyn Any + Send>) -> Response {
    let text = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
    Problem::internal(text.unwrap_or_else(|| "panic".to_owned())).into_response()
}

/// The metrics of the process. The recorder is global, so all servers of a process share it.
pub(super) fn metrics_handle() -> &'static PrometheusHandle {
    static HANDLE: OnceLock<PrometheusHandle> = OnceLock::new();
    HANDLE.get_or_init(|| {
        let buckets = [0.001, 0.005, 0.02, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0, 60.0];
        let builder = PrometheusBuilder::new();
        // This can fail only for an empty list.
        let recorder = match builder.set_buckets(&buckets) {
            Ok(builder) => builder.build_recorder(),
            Err(_) => PrometheusBuilder::new().build_recorder(),
        };
        let handle = recorder.handle();
        if metrics::set_global_recorder(recorder).is_err() {
            tracing::warn!("another metrics recorder is already installed; /metrics stays empty");
        }
        handle
    })
}
