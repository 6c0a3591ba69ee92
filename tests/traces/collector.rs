//! A collector that receives OTLP over HTTP and keeps the spans.

use std::sync::{Arc, Mutex};

use axum::body::Bytes;
use axum::routing::post;
use opentelemetry_proto::tonic::collector::trace::v1::ExportTraceServiceRequest;
use opentelemetry_proto::tonic::common::v1::KeyValue;
use opentelemetry_proto::tonic::common::v1::any_value::Value;
use opentelemetry_proto::tonic::trace::v1::Span;
use prost::Message;

/// A received span.
#[derive(Debug, Clone)]
pub struct Sent {
    pub service: String,
    pub name: String,
    pub kind: i32,
    pub trace: String,
    pub id: String,
    pub parent: String,
    attributes: Vec<KeyValue>,
}

impl Sent {
    fn new(service: &str, span: Span) -> Self {
        let hex = |bytes: &[u8]| bytes.iter().map(|b| format!("{b:02x}")).collect();
        Self {
            service: service.to_owned(),
            name: span.name,
            kind: span.kind,
            trace: hex(&span.trace_id),
            id: hex(&span.span_id),
            parent: hex(&span.parent_span_id),
            attributes: span.attributes,
        }
    }

    /// An attribute as text.
    pub fn attribute(&self, name: &str) -> Option<String> {
        text(&self.attributes, name)
    }
}

fn text(attributes: &[KeyValue], name: &str) -> Option<String> {
    let found = attributes.iter().find(|attribute| attribute.key == name)?;
    match found.value.as_ref()?.value.as_ref()? {
        Value::StringValue(text) => Some(text.clone()),
        Value::IntValue(number) => Some(number.to_string()),
        other => Some(format!("{other:?}")),
    }
}

/// A collector on a free port.
pub struct Collector {
    pub endpoint: String,
    spans: Arc<Mutex<Vec<Sent>>>,
}

impl Collector {
    pub async fn start() -> Self {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let endpoint = format!("http://{}", listener.local_addr().unwrap());
        let spans = Arc::<Mutex<Vec<Sent>>>::default();
        let kept = spans.clone();
        let take = move |body: Bytes| async move {
            for resource in ExportTraceServiceRequest::decode(body).unwrap().resource_spans {
                let attributes = resource.resource.unwrap_or_default().attributes;
                let service = text(&attributes, "service.name").unwrap_or_default();
                let sent = resource.scope_spans.into_iter().flat_map(|scope| scope.spans);
                kept.lock().unwrap().extend(sent.map(|span| Sent::new(&service, span)));
            }
        };
        let router = axum::Router::new().route("/v1/traces", post(take));
        tokio::spawn(async move { axum::serve(listener, router).await });
        Self { endpoint, spans }
    }

    /// The spans received so far.
    pub fn spans(&self) -> Vec<Sent> {
        self.spans.lock().unwrap().clone()
    }

    /// The spans with a name, in the order in which they ended.
    pub fn named(&self, name: &str) -> Vec<Sent> {
        self.spans().into_iter().filter(|span| span.name == name).collect()
    }

    /// The only span with a name.
    pub fn one(&self, name: &str) -> Sent {
        let mut found = self.named(name);
        assert_eq!(found.len(), 1, "{name} in {:#?}", self.spans());
        found.remove(0)
    }
}
