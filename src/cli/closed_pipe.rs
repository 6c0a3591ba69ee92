//! Ends a command quietly when the reader of its output has closed the pipe, as in `relume explain MODEL | head`.
//!
//! `println!` panics then. The panic unwinds, so that temporary files are removed, and is not reported.

use std::any::Any;
use std::error::Error;
use std::io::ErrorKind;
use std::panic::AssertUnwindSafe;
use std::process::ExitCode;

use crate::cli::error::CLOSED_PIPE;

/// Runs a command. Its exit code is [`CLOSED_PIPE`] if it wrote to a closed pipe.
pub(super) fn guard(command: impl FnOnce() -> ExitCode) -> ExitCode {
    let report = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if !is_closed_pipe(panic.payload()) {
            report(panic);
        }
    }));
    match std::panic::catch_unwind(AssertUnwindSafe(command)) {
        Ok(code) => code,
        Err(panic) if is_closed_pipe(&*panic) => ExitCode::from(CLOSED_PIPE),
        Err(panic) => std::panic::resume_unwind(panic),
    }
}

/// Whether an error of a command is that of a closed pipe.
pub(super) fn is_cause(error: &(dyn Error + 'static)) -> bool {
    error.downcast_ref::<std::io::Error>().is_some_and(|error| error.kind() == ErrorKind::BrokenPipe)
}

/// Whether a panic is that of `println!` or `eprintln!` on a closed pipe.
fn is_closed_pipe(panic: &(dyn Any + Send)) -> bool {
    let closed = std::io::Error::from_raw_os_error(rustix::io::Errno::PIPE.raw_os_error()).to_string();
    let text = panic.downcast_ref::<String>();
    text.is_some_and(|text| text.starts_with("failed printing to std") && text.ends_with(&closed))
}
