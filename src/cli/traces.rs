//! Sends spans to an OpenTelemetry collector according to the standard variables `OTEL_*`: OTLP as protobuf over HTTP, in batches
//! from a separate thread. Code that creates spans never waits for the collector.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use opentelemetry::trace::{SpanKind, TracerProvider};
use opentelemetry::{Key, KeyValue};
use opentelemetry_otlp::{Protocol, WithExportConfig};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::error::OTelSdkResult;
use opentelemetry_sdk::trace::{SdkTracerProvider, SpanData, SpanExporter};
use tracing_subscriber::{EnvFilter, Layer, Registry};

/// The variable that selects the spans to send, in the syntax of `RUST_LOG`.
const FILTER: &str = "RELUME_TRACE_FILTER";
/// The filter if the variable is not set.
const DEFAULT_FILTER: &str = "relume=info";
/// Maximum time that the process waits for the collector at its end.
const FLUSH_TIMEOUT: Duration = Duration::from_secs(3);
const SERVICE_NAME: Key = Key::from_static_str("service.name");

/// Sends the recorded spans.
pub(super) struct SpanSender {
    provider: SdkTracerProvider,
    is_away: Arc<AtomicBool>,
}

impl SpanSender {
    /// Sends the remaining spans, for at most [`FLUSH_TIMEOUT`].
    pub(super) fn finish(self) {
        let sent = self.provider.shutdown_with_timeout(FLUSH_TIMEOUT);
        // If the collector is already unreachable, a warning was logged before.
        if let (Err(error), false) = (sent, self.is_away.load(Ordering::Relaxed)) {
            tracing::warn!(%error, "the last spans were not sent");
        }
    }
}

/// The layer that records spans, and their sender.
///
/// # Errors
/// If the variables are invalid.
pub(super) fn start() -> Result<(Box<dyn Layer<Registry> + Send + Sync>, SpanSender), String> {
    // TLS for a collector at `https://`. If the process already has a crypto provider, that one is used.
    tokio_rustls::rustls::crypto::ring::default_provider().install_default().ok();
    let directives = std::env::var(FILTER).unwrap_or_else(|_| DEFAULT_FILTER.to_owned());
    let filter = EnvFilter::try_new(&directives).map_err(|error| format!("{FILTER}: {error}"))?;
    let http = opentelemetry_otlp::SpanExporter::builder().with_http().with_protocol(Protocol::HttpBinary);
    let otlp = http.build().map_err(|error| error.to_string())?;
    let is_away = Arc::<AtomicBool>::default();
    let exporter = Exporter { otlp, is_away: is_away.clone() };
    let provider =
        SdkTracerProvider::builder().with_batch_exporter(exporter).with_resource(resource()).build();
    let layer = tracing_opentelemetry::layer()
        .with_tracer(provider.tracer("relume"))
        // `tracing` knows the current span, so OpenTelemetry's current context is not needed.
        .with_context_activation(false)
        .with_tracked_inactivity(false)
        .with_location(false)
        .with_threads(false)
        .with_filter(filter);
    Ok((layer.boxed(), SpanSender { provider, is_away }))
}

/// The description of this process, with the service name from the variables.
fn resource() -> Resource {
    let found = Resource::builder().build();
    let is_named = found.get(&SERVICE_NAME).is_some_and(|name| !name.as_str().starts_with("unknown_service"));
    let builder =
        if is_named { Resource::builder() } else { Resource::builder().with_service_name("relume") };
    builder.with_attribute(KeyValue::new("service.version", env!("CARGO_PKG_VERSION"))).build()
}

/// Sends batches. Logs one warning when the collector becomes unreachable; spans are lost until it is reachable again.
#[derive(Debug)]
struct Exporter {
    otlp: opentelemetry_otlp::SpanExporter,
    is_away: Arc<AtomicBool>,
}

impl SpanExporter for Exporter {
    async fn export(&self, mut batch: Vec<SpanData>) -> OTelSdkResult {
        batch.iter_mut().for_each(name_request);
        let sent = self.otlp.export(batch).await;
        let was_away = self.is_away.swap(sent.is_err(), Ordering::Relaxed);
        match &sent {
            Ok(()) if was_away => tracing::info!("the trace collector accepts spans again"),
            Err(error) if !was_away => {
                tracing::warn!(%error, "the trace collector accepts no spans; they are lost until it accepts them again");
            }
            _ => {}
        }
        sent
    }

    fn shutdown_with_timeout(&self, timeout: Duration) -> OTelSdkResult {
        self.otlp.shutdown_with_timeout(timeout)
    }

    fn force_flush(&self) -> OTelSdkResult {
        self.otlp.force_flush()
    }

    fn set_resource(&mut self, resource: &Resource) {
        self.otlp.set_resource(resource);
    }
}

/// Renames the span of a request and its attributes to OpenTelemetry's conventions for HTTP. The log uses the original names.
fn name_request(span: &mut SpanData) {
    if span.name != "request" {
        return;
    }
    span.span_kind = SpanKind::Server;
    let mut take = |from: &str, to: &'static str| {
        let found = span.attributes.iter_mut().find(|attribute| attribute.key.as_str() == from)?;
        found.key = Key::from_static_str(to);
        Some(found.value.as_str().into_owned())
    };
    if let (Some(method), Some(route)) = (take("method", "http.request.method"), take("route", "http.route"))
    {
        span.name = format!("{method} {route}").into();
    }
}

#[cfg(test)]
mod tests {
    use std::time::SystemTime;

    use opentelemetry::trace::{SpanContext, SpanId, Status};
    use opentelemetry::{InstrumentationScope, Value};

    use super::*;

    fn span(name: &'static str) -> SpanData {
        let attribute = |key, value: &'static str| KeyValue::new(key, Value::from(value));
        SpanData {
            span_context: SpanContext::NONE,
            parent_span_id: SpanId::INVALID,
            parent_span_is_remote: false,
            span_kind: SpanKind::Internal,
            name: name.into(),
            start_time: SystemTime::UNIX_EPOCH,
            end_time: SystemTime::UNIX_EPOCH,
            attributes: vec![attribute("method", "GET"), attribute("route", "/v1/jobs/{id}")],
            dropped_attributes_count: 0,
            events: Default::default(),
            links: Default::default(),
            status: Status::Unset,
            instrumentation_scope: InstrumentationScope::default(),
        }
    }

    #[test]
    fn only_request_spans_are_named_by_method_and_route() {
        let mut request = span("request");
        name_request(&mut request);
        assert_eq!((&*request.name, request.span_kind), ("GET /v1/jobs/{id}", SpanKind::Server));
        assert_eq!(request.attributes[1].key.as_str(), "http.route");
        let mut other = span("draw");
        name_request(&mut other);
        assert_eq!(other, span("draw"));
    }
}
