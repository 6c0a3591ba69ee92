//! Seconds of the stages of a training, from the spans that trainer and engine enter.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use tracing::span::Id;
use tracing::subscriber::Subscriber;
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;
use tracing_subscriber::registry::LookupSpan;

/// Seconds by name of the span, without the spans inside it. A clone shares them. The spans of one thread only: the stages of a training.
#[derive(Clone, Default)]
pub(super) struct StageTimes(Arc<Mutex<Inner>>);

#[derive(Default)]
struct Inner {
    seconds: BTreeMap<&'static str, f64>,
    /// Spans that are entered now, outermost first: start, and seconds in spans inside.
    entered: Vec<(Instant, f64)>,
}

impl StageTimes {
    /// The seconds so far.
    pub(super) fn seconds(&self) -> BTreeMap<&'static str, f64> {
        self.lock().seconds.clone()
    }

    /// Sets the seconds so far.
    pub(super) fn reset(&self, seconds: BTreeMap<&'static str, f64>) {
        self.lock().seconds = seconds;
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Inner> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<S: Subscriber + for<'a> LookupSpan<'a>> Layer<S> for StageTimes {
    fn on_enter(&self, _: &Id, _: Context<'_, S>) {
        self.lock().entered.push((Instant::now(), 0.0));
    }

    fn on_exit(&self, id: &Id, context: Context<'_, S>) {
        let mut inner = self.lock();
        let Some((start, inside)) = inner.entered.pop() else { return };
        let total = start.elapsed().as_secs_f64();
        if let Some((_, inside)) = inner.entered.last_mut() {
            *inside += total;
        }
        if let Some(span) = context.span(id) {
            *inner.seconds.entry(span.name()).or_default() += total - inside;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;
    use tracing_subscriber::layer::SubscriberExt;

    #[test]
    fn time_of_inner_stages_is_not_counted_twice() {
        let times = StageTimes::default();
        let subscriber = tracing_subscriber::registry().with(times.clone());
        let start = Instant::now();
        tracing::subscriber::with_default(subscriber, || {
            let _outer = tracing::debug_span!("outer").entered();
            for _ in 0..2 {
                let _inner = tracing::debug_span!("inner").entered();
                std::thread::sleep(Duration::from_millis(20));
            }
        });
        let (seconds, total) = (times.seconds(), start.elapsed().as_secs_f64());
        assert!(seconds["inner"] >= 0.04, "{seconds:?}");
        assert!(seconds["outer"] <= total - seconds["inner"], "{seconds:?}");
    }
}
