//! Sends spans to an OpenTelemetry collector, as the standard variables `OTEL_*` say: OTLP as protobuf over HTTP, in batches from a
//! thread of its own. Whoever makes spans never waits for it.

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

/// Which spans are sent, in the syntax of `RUST_LOG`.
const FILTER: &str = "RELUME_TRACE_FILTER";
/// What is sent where that says nothing.
const DEFAULT_FILTER: &str = "relume=info";
/// How long the end of the process waits for the collector.
const FLUSH_TIMEOUT: Duration = Duration::from_secs(3);
const SERVICE_NAME: Key = Key::from_static_str("service.name");

/// Sends what the layer takes.
pub(super) struct SpanSender {
    provider: SdkTracerProvider,
    is_away: Arc<AtomicBool>,
}

impl SpanSender {
    /// Sends what waits, as long as that takes no more than a few seconds.
    pub(super) fn finish(self) {
        let sent = self.provider.shutdown_with_timeout(FLUSH_TIMEOUT);
        // One warning is enough.
        if let (Err(error), false) = (sent, self.is_away.load(Ordering::Relaxed)) {
            tracing::warn!(%error, "the last spans were not sent");
        }
    }
}

/// The layer that takes spans, and what sends them.
///
/// # Errors
/// What is wrong with the variables.
pub(super) fn start() -> Result<(Box<dyn Layer<Registry> + Send + Sync>, SpanSender), String> {
    // For a collector at `https://`. Another provider of the process is as good.
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
        // Nothing here asks for the current context of OpenTelemetry: `tracing` knows it.
        .with_context_activation(false)
        .with_tracked_inactivity(false)
        .with_location(false)
        .with_threads(false)
        .with_filter(filter);
    Ok((layer.boxed(), SpanSender { provider, is_away }))
}

/// Who sends, with the name that the variables give.
fn resource() -> Resource {
    let found = Resource::builder().build();
    let is_named = found.get(&SERVICE_NAME).is_some_and(|name| !name.as_str().starts_with("unknown_service"));
    let builder =
        if is_named { Resource::builder() } else { Resource::builder().with_service_name("relume") };
    builder.with_attribute(KeyValue::new("service.version", env!("CARGO_PKG_VERSION"))).build()
}

/// Sends batches, and warns once when the collector goes away: spans of that time are lost.
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
            Ok(()) if was_away => tracing::info!("the collector of traces takes spans again"),
            Err(error) if !was_away => {
                tracing::warn!(%error, "the collector of traces takes no spans; they are lost until it does");
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

/// Calls the span of a request what OpenTelemetry's conventions for HTTP call it. In the log it has the names of the log.
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
