//! Starts the log of the process and, if configured, its traces.

use std::io::IsTerminal;

use tracing_subscriber::fmt::format::FmtSpan;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Layer, Registry, fmt};

#[cfg(feature = "otlp")]
use crate::cli::traces;

/// The OpenTelemetry variables that name a collector.
const COLLECTORS: [&str; 2] = ["OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT"];

type AnyLayer = Box<dyn Layer<Registry> + Send + Sync>;

/// The trace sender of this process.
#[derive(Default)]
pub(super) struct Traces {
    #[cfg(feature = "otlp")]
    sender: Option<traces::SpanSender>,
}

impl Traces {
    /// Sends the remaining spans. Call it when the process has finished its work.
    pub(super) fn finish(self) {
        #[cfg(feature = "otlp")]
        if let Some(sender) = self.sender {
            sender.finish();
        }
    }
}

/// Logs to standard error, filtered by `RUST_LOG`. By default a service logs its operations, and other commands log only warnings
/// and errors; if `RUST_LOG` selects spans, they also log the duration of each. A service sends traces if a collector is named.
pub(super) fn start(json: bool, is_service: bool) -> Traces {
    let default_level = if is_service { "relume=info,warn" } else { "warn" };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(default_level));
    let spans = if is_service { FmtSpan::NONE } else { FmtSpan::CLOSE };
    let log = fmt::layer()
        .with_span_events(spans)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal());
    let log: AnyLayer =
        if json { log.json().with_filter(filter).boxed() } else { log.with_filter(filter).boxed() };
    let (layer, traces, warning) =
        if is_service && is_wanted() { started() } else { (None, Traces::default(), None) };
    let layers: Vec<AnyLayer> = std::iter::once(log).chain(layer).collect();
    tracing_subscriber::registry().with(layers).init();
    if let Some(why) = warning {
        tracing::warn!(why, "traces are not sent");
    }
    traces
}

/// Whether the OpenTelemetry variables request traces.
fn is_wanted() -> bool {
    let is =
        |name: &str, value: &str| std::env::var(name).is_ok_and(|found| found.eq_ignore_ascii_case(value));
    let is_named = |name: &str| std::env::var_os(name).is_some_and(|found| !found.is_empty());
    COLLECTORS.into_iter().any(is_named)
        && !is("OTEL_SDK_DISABLED", "true")
        && !is("OTEL_TRACES_EXPORTER", "none")
}

/// The layer that records spans and their sender, or the reason why there are none.
#[cfg(feature = "otlp")]
fn started() -> (Option<AnyLayer>, Traces, Option<String>) {
    match traces::start() {
        Ok((layer, sender)) => (Some(layer), Traces { sender: Some(sender) }, None),
        Err(why) => (None, Traces::default(), Some(why)),
    }
}

/// The layer that records spans and their sender, or the reason why there are none.
#[cfg(not(feature = "otlp"))]
fn started() -> (Option<AnyLayer>, Traces, Option<String>) {
    let why =
        format!("{} is set, but this program was built without the feature `otlp`", COLLECTORS.join(" or "));
    (None, Traces::default(), Some(why))
}
