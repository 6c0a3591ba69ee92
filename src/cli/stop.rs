//! SIGTERM and SIGINT: the first lets a command save its progress, the second ends the process at once.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use signal_hook::low_level;

use crate::cli::error::STOPPED;

/// Programs such as `timeout` send a signal to a process and again to its process group. A signal that is repeated within this time is
/// part of the same request.
const REPETITION: Duration = Duration::from_secs(1);

/// A request to stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum StopRequest {
    /// The command saves its progress and ends.
    Save,
    /// The process ends at once. By convention its exit code is 128 and the number of the signal.
    Exit { code: i32 },
}

/// Calls `handle` in a thread of its own, once with [`StopRequest::Save`] and again for each further request.
///
/// # Errors
/// If the operating system refuses a signal handler or a thread.
pub(super) fn on_stop(mut handle: impl FnMut(StopRequest) + Send + 'static) -> std::io::Result<()> {
    let mut signals = Signals::new([SIGTERM, SIGINT])?;
    std::thread::Builder::new().name("signals".to_owned()).spawn(move || {
        let mut first = None;
        for signal in signals.forever() {
            if let Some(request) = request(&mut first, signal, Instant::now()) {
                handle(request);
            }
        }
    })?;
    Ok(())
}

/// The request of `signal`, unless it repeats the first one. `first` is the first signal and its time.
fn request(first: &mut Option<(i32, Instant)>, signal: i32, now: Instant) -> Option<StopRequest> {
    match *first {
        None => {
            *first = Some((signal, now));
            Some(StopRequest::Save)
        }
        Some((known, at)) if known == signal && now.saturating_duration_since(at) < REPETITION => None,
        Some(_) => Some(StopRequest::Exit { code: 128 + signal }),
    }
}

/// Whether the process received SIGTERM or SIGINT. A second request ends the process at once.
pub(super) struct StopSignal {
    requested: Arc<AtomicBool>,
    /// There is nothing to save yet, so the first signal also ends the process.
    is_early: Arc<AtomicBool>,
}

impl StopSignal {
    /// Starts to handle the signals. Until [`StopSignal::wait`] a signal ends the process at once with the exit code [`STOPPED`].
    ///
    /// # Errors
    /// See [`on_stop`].
    pub(super) fn listen() -> std::io::Result<Self> {
        let (requested, is_early) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(true)));
        let (sets, asks) = (Arc::clone(&requested), Arc::clone(&is_early));
        on_stop(move |request| match request {
            StopRequest::Save if asks.load(Ordering::SeqCst) => low_level::exit(STOPPED.into()),
            StopRequest::Save => sets.store(true, Ordering::SeqCst),
            StopRequest::Exit { code } => low_level::exit(code),
        })?;
        Ok(Self { requested, is_early })
    }

    /// From now on the first signal only sets [`StopSignal::is_requested`].
    pub(super) fn wait(&self) {
        self.is_early.store(false, Ordering::SeqCst);
    }

    pub(super) fn is_requested(&self) -> bool {
        self.requested.load(Ordering::SeqCst)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_signal_that_is_sent_twice_is_one_request() {
        let start = Instant::now();
        let at = |milliseconds| start + Duration::from_millis(milliseconds);
        let mut first = None;
        assert_eq!(request(&mut first, SIGTERM, start), Some(StopRequest::Save));
        assert_eq!(request(&mut first, SIGTERM, at(1)), None);
        assert_eq!(request(&mut first, SIGTERM, at(999)), None);
        assert_eq!(request(&mut first, SIGTERM, at(1_000)), Some(StopRequest::Exit { code: 143 }));
    }

    #[test]
    fn another_signal_is_a_second_request() {
        let start = Instant::now();
        let mut first = None;
        assert_eq!(request(&mut first, SIGTERM, start), Some(StopRequest::Save));
        assert_eq!(request(&mut first, SIGINT, start), Some(StopRequest::Exit { code: 130 }));
    }
}
