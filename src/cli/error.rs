//! The result type of commands, and the exit codes of the program.

/// Any error.
pub(super) type BoxError = Box<dyn std::error::Error + Send + Sync>;

/// The result of a command. An error is printed on standard error.
pub(super) type CommandResult<T = ()> = Result<T, BoxError>;

/// The exit code of a command that was stopped and can continue: EX_TEMPFAIL of sysexits.h. Schedulers restart such a job.
pub(super) const STOPPED: u8 = 75;

/// The exit code of a command whose reader closed the pipe: that of a program that SIGPIPE ends, 128 + 13.
pub(super) const CLOSED_PIPE: u8 = 141;

/// The last paragraph of `--help`.
pub(super) const EXIT_CODES: &str = "Exit codes: 0 success; 1 failure; 2 invalid usage; 75 stopped before the end, progress is \
    saved: run the command again to continue; 141 the reader of the output closed the pipe.";
