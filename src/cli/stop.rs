//! A stop that keeps what was done.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use crate::cli::error::STOPPED;

/// Whether SIGTERM or SIGINT has come. The second one ends the program at once.
pub(super) struct StopSignal {
    requested: Arc<AtomicBool>,
    /// Nothing is there yet that has to be kept: also the first one ends the program.
    is_early: Arc<AtomicBool>,
}

impl StopSignal {
    /// Listens from now on. Until [`StopSignal::wait`] a signal ends the program with the code of a stop, at once.
    ///
    /// # Errors
    /// Where the system takes no handler.
    pub(super) fn listen() -> std::io::Result<Self> {
        let (requested, is_early) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(true)));
        for signal in [SIGTERM, SIGINT] {
            flag::register_conditional_shutdown(signal, STOPPED.into(), Arc::clone(&is_early))?;
            flag::register_conditional_shutdown(signal, 128 + signal, Arc::clone(&requested))?;
            flag::register(signal, Arc::clone(&requested))?;
        }
        Ok(Self { requested, is_early })
    }

    /// From now on the first signal waits until [`StopSignal::is_requested`] is asked.
    pub(super) fn wait(&self) {
        self.is_early.store(false, Ordering::SeqCst);
    }

    pub(super) fn is_requested(&self) -> bool {
        self.requested.load(Ordering::SeqCst)
    }
}
