//! What a command returns.

/// Any error.
pub(super) type BoxError = Box<dyn std::error::Error + Send + Sync>;

/// The result of a command; the error is printed on standard error.
pub(super) type CommandResult<T = ()> = Result<T, BoxError>;
