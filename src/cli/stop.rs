//! Stop signals that let a command save its progress.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use crate::cli::error::STOPPED;

/// Whether the process received SIGTERM or SIGINT. A second signal ends the process immediately.
pub(super) struct StopSignal {
    requested: Arc<AtomicBool>,
    /// There is nothing to save yet, so the first signal also ends the process.
    is_early: Arc<AtomicBool>,
}

impl StopSignal {
    /// Starts to handle the signals. Until [`StopSignal::wait`] a signal ends the process immediately with the exit code
    /// [`STOPPED`].
    ///
    /// # Errors
    /// If the operating system refuses a signal handler.
    pub(super) fn listen() -> std::io::Result<Self> {
        let (requested, is_early) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(true)));
        for signal in [SIGTERM, SIGINT] {
            flag::register_conditional_shutdown(signal, STOPPED.into(), Arc::clone(&is_early))?;
            flag::register_conditional_shutdown(signal, 128 + signal, Arc::clone(&requested))?;
            flag::register(signal, Arc::clone(&requested))?;
        }
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
