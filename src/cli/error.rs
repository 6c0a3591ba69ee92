//! What a command returns, and the exit codes of the program.

/// Any error.
pub(super) type BoxError = Box<dyn std::error::Error + Send + Sync>;

/// The result of a command; the error is printed on standard error.
pub(super) type CommandResult<T = ()> = Result<T, BoxError>;

/// The exit code of what was stopped and can go on, EX_TEMPFAIL of sysexits.h; schedulers run such a job again.
pub(super) const STOPPED: u8 = 75;

/// The end of `--help`.
pub(super) const EXIT_CODES: &str = "Exit codes: 0 done; 1 failed; 2 wrong usage; 75 stopped before the end, what was done is kept: \
    run it again to go on.";
