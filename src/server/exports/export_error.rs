//! Why an export is not made to its end.

use std::time::Duration;

use tokio::time::Instant;

use crate::server::problem::Problem;
use crate::store::StoreError;
use relume_api::problem::TYPE_PREFIX;

/// How long it is tried again while the server is busy.
const MAX_BUSY_WAIT: Duration = Duration::from_secs(3600);
/// Time between two tries.
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// Why an export is not made to its end.
#[derive(Debug)]
pub(super) enum ExportError {
    /// It was cancelled or deleted, or the server stops.
    Unwanted,
    /// It cannot be made.
    Failed {
        /// Stable code: the kind of the problem that a request would have met, or `export_failed`.
        code: String,
        /// What is wrong, for people.
        detail: String,
    },
}

impl ExportError {
    /// For what no request would have met.
    pub(super) fn failed(detail: impl Into<String>) -> Self {
        Self::Failed { code: "export_failed".to_owned(), detail: detail.into() }
    }
}

impl From<Problem> for ExportError {
    fn from(problem: Problem) -> Self {
        let problem = relume_api::Problem::from(problem);
        let code = problem.kind.strip_prefix(TYPE_PREFIX).unwrap_or(&problem.kind).to_owned();
        let field = problem.errors.first().map(|error| format!("{}: {}", error.pointer, error.detail));
        Self::Failed { code, detail: field.or(problem.detail).unwrap_or(problem.title) }
    }
}

impl From<StoreError> for ExportError {
    fn from(error: StoreError) -> Self {
        Problem::from(error).into()
    }
}

impl From<std::io::Error> for ExportError {
    fn from(error: std::io::Error) -> Self {
        StoreError::from(error).into()
    }
}

/// Waits while the server is busy, for an hour from when it began.
pub(super) struct BusyRetry(Instant);

impl BusyRetry {
    /// Begins now.
    pub(super) fn new() -> Self {
        Self(Instant::now())
    }

    /// Ends when it is time to ask again after a refusal.
    ///
    /// # Errors
    /// The refusal, when asking again would not help or has not helped for an hour.
    pub(super) async fn wait(&self, refusal: Problem) -> Result<(), ExportError> {
        if refusal.status != 503 || self.0.elapsed() > MAX_BUSY_WAIT {
            return Err(refusal.into());
        }
        tokio::time::sleep(RETRY_INTERVAL).await;
        Ok(())
    }
}
