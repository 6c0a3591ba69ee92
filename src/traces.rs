//! Links spans to traces by the header `traceparent` of W3C Trace Context, and sets attributes of spans. Spans are those of
//! `tracing`. With the feature `otlp` the command line sends them to a collector.

use std::fmt;

use tracing::Span;

/// The name of the header.
pub(crate) const HEADER: &str = "traceparent";

/// Length of a `traceparent` of version 00.
const LENGTH: usize = 55;

/// A valid `traceparent`: a span of a trace, possibly of another process.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct TraceParent {
    trace: String,
    span: String,
    flags: String,
}

impl TraceParent {
    /// Parses a header; `None` if it is invalid, in which case a new trace begins, as the standard requires. For a later version
    /// the fields of version 00 are read.
    pub(crate) fn parse(text: &str) -> Option<Self> {
        let (known, rest) = text.split_at_checked(LENGTH)?;
        let mut parts = known.split('-');
        let mut next = |length: usize| {
            let is_hex = |part: &&str| part.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'));
            parts.next().filter(|part| part.len() == length).filter(is_hex)
        };
        let (version, trace, span, flags) = (next(2)?, next(32)?, next(16)?, next(2)?);
        let is_right = match version {
            "00" => rest.is_empty(),
            "ff" => false,
            _ => rest.is_empty() || rest.starts_with('-'),
        };
        let is_zero = |id: &str| id.bytes().all(|b| b == b'0');
        (is_right && !is_zero(trace) && !is_zero(span)).then(|| Self {
            trace: trace.to_owned(),
            span: span.to_owned(),
            flags: flags.to_owned(),
        })
    }
}

impl fmt::Display for TraceParent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "00-{}-{}-{}", self.trace, self.span, self.flags)
    }
}

/// Makes a new span, which has not been entered yet, a child of `parent`. Has no effect without traces.
#[cfg(feature = "otlp")]
pub(crate) fn link_parent(span: &Span, parent: &TraceParent) {
    use opentelemetry::Context;
    use opentelemetry::trace::{SpanContext, SpanId, TraceContextExt, TraceFlags, TraceId, TraceState};
    use tracing_opentelemetry::OpenTelemetrySpanExt;

    let (Ok(trace), Ok(id), Ok(flags)) = (
        TraceId::from_hex(&parent.trace),
        SpanId::from_hex(&parent.span),
        u8::from_str_radix(&parent.flags, 16),
    ) else {
        return;
    };
    let context = SpanContext::new(trace, id, TraceFlags::new(flags), true, TraceState::NONE);
    // This fails if no layer records spans, which is not an error.
    span.set_parent(Context::new().with_remote_span_context(context)).ok();
}

/// Makes a new span, which has not been entered yet, a child of `parent`. Has no effect without traces.
#[cfg(not(feature = "otlp"))]
pub(crate) fn link_parent(_span: &Span, _parent: &TraceParent) {}

/// The span as a `traceparent`; `None` if it belongs to no trace.
#[cfg(feature = "otlp")]
pub(crate) fn as_parent(span: &Span) -> Option<TraceParent> {
    use opentelemetry::trace::TraceContextExt;
    use tracing_opentelemetry::OpenTelemetrySpanExt;

    let context = span.context();
    let context = context.span().span_context().clone();
    context.is_valid().then(|| TraceParent {
        trace: context.trace_id().to_string(),
        span: context.span_id().to_string(),
        flags: format!("{:02x}", context.trace_flags().to_u8()),
    })
}

/// The span as a `traceparent`; `None` if it belongs to no trace.
#[cfg(not(feature = "otlp"))]
pub(crate) fn as_parent(_span: &Span) -> Option<TraceParent> {
    None
}

/// Records the status of a request's answer; 500 and above are errors.
#[cfg(feature = "otlp")]
pub(crate) fn record_status(span: &Span, status: u16) {
    use tracing_opentelemetry::OpenTelemetrySpanExt;

    span.set_attribute("http.response.status_code", i64::from(status));
    if status >= 500 {
        record_error(span, "the server failed");
    }
}

/// Records the status of a request's answer; 500 and above are errors.
#[cfg(not(feature = "otlp"))]
pub(crate) fn record_status(_span: &Span, _status: u16) {}

/// Marks a span as failed.
#[cfg(feature = "otlp")]
pub(crate) fn record_error(span: &Span, why: &'static str) {
    use opentelemetry::trace::Status;
    use tracing_opentelemetry::OpenTelemetrySpanExt;

    span.set_status(Status::error(why));
}

/// Marks a span as failed.
#[cfg(not(feature = "otlp"))]
pub(crate) fn record_error(_span: &Span, _why: &'static str) {}

#[cfg(test)]
mod tests {
    use super::*;

    /// The example of the standard.
    const VALID: &str = "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01";

    fn read(text: &str) -> Option<String> {
        TraceParent::parse(text).map(|parent| parent.to_string())
    }

    #[test]
    fn valid_traceparent_is_parsed_and_written_back_unchanged() {
        assert_eq!(read(VALID).as_deref(), Some(VALID));
        let unsampled = VALID.replace("-01", "-00");
        assert_eq!(read(&unsampled), Some(unsampled));
        let later = format!("cc{}-what-the-future-will-be-like", &VALID[2..]);
        assert_eq!(read(&later).as_deref(), Some(VALID), "a later version is read as version 00");
    }

    #[test]
    fn invalid_traceparents_are_ignored() {
        for wrong in [
            String::new(),
            "00".to_owned(),
            VALID.to_uppercase(),
            VALID.replace("4bf9", "4bg9"),
            VALID.replace("00-4", "ff-4"),
            VALID.replace('-', "_"),
            format!("{VALID}-01"),
            format!("cc{}.", &VALID[2..]),
            VALID[..54].to_owned(),
            VALID.replace("4bf92f3577b34da6a3ce929d0e0e4736", &"0".repeat(32)),
            VALID.replace("00f067aa0ba902b7", &"0".repeat(16)),
            VALID.replace("00f067aa0ba902b7", "00f067aa0ba902ü"),
        ] {
            assert_eq!(read(&wrong), None, "{wrong:?}");
        }
    }

    #[test]
    fn without_a_collector_spans_have_no_trace_parent() {
        let span = tracing::info_span!("request");
        link_parent(&span, &TraceParent::parse(VALID).unwrap());
        assert_eq!(as_parent(&span), None);
    }
}
