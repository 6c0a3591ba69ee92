//! A stop that keeps what was done.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use crate::cli::error::STOPPED;

/// Whether SIGTERM or SIGINT has come. The second one ends the program at once.
pub(super) struct Stop {
    asked: Arc<AtomicBool>,
    /// Nothing is there yet that has to be kept: also the first one ends the program.
    is_early: Arc<AtomicBool>,
}

impl Stop {
    /// Listens from now on. Until [`Stop::wait`] a signal ends the program with the code of a stop, at once.
    ///
    /// # Errors
    /// Where the system takes no handler.
    pub(super) fn listen() -> std::io::Result<Self> {
        let (asked, is_early) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(true)));
        for signal in [SIGTERM, SIGINT] {
            flag::register_conditional_shutdown(signal, STOPPED.into(), Arc::clone(&is_early))?;
            flag::register_conditional_shutdown(signal, 128 + signal, Arc::clone(&asked))?;
            flag::register(signal, Arc::clone(&asked))?;
        }
        Ok(Self { asked, is_early })
    }

    /// From now on the first signal waits until [`Stop::is_asked`] is asked.
    pub(super) fn wait(&self) {
        self.is_early.store(false, Ordering::SeqCst);
    }

    pub(super) fn is_asked(&self) -> bool {
        self.asked.load(Ordering::SeqCst)
    }
}
