//! The reasons why an export does not succeed.

use std::time::Duration;

use tokio::time::Instant;

use crate::server::problem::Problem;
use crate::store::StoreError;
use relume_api::problem::TYPE_PREFIX;

/// Maximum time for retries while the server is busy.
const MAX_BUSY_WAIT: Duration = Duration::from_secs(3600);
/// Delay between two attempts.
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// Why an export does not succeed.
#[derive(Debug)]
pub(super) enum ExportError {
    /// It was cancelled or deleted, its model was replaced, or the server is stopping.
    Unwanted,
    /// The disk is full or the database cannot be reached. The export continues when that has changed.
    Paused(StoreError),
    /// It failed.
    Failed {
        /// Stable code: the kind of the problem that a request would have returned, or `export_failed`.
        code: String,
        /// Description of the failure.
        detail: String,
    },
}

impl ExportError {
    /// A failure without a corresponding problem of a request.
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
        match error {
            StoreError::Full | StoreError::NoDiskSpace { .. } | StoreError::DatabaseUnreachable(_) => {
                Self::Paused(error)
            }
            error => Problem::from(error).into(),
        }
    }
}

impl From<std::io::Error> for ExportError {
    fn from(error: std::io::Error) -> Self {
        StoreError::from(error).into()
    }
}

/// Limits retries while the server is busy to an hour after its creation.
pub(super) struct BusyRetry(Instant);

impl BusyRetry {
    /// Starts the hour.
    pub(super) fn new() -> Self {
        Self(Instant::now())
    }

    /// Waits before the next attempt after a refusal.
    ///
    /// # Errors
    /// The refusal, if a retry cannot help or the hour has passed.
    pub(super) async fn wait(&self, refusal: Problem) -> Result<(), ExportError> {
        if refusal.status != 503 || self.0.elapsed() > MAX_BUSY_WAIT {
            return Err(refusal.into());
        }
        tokio::time::sleep(RETRY_INTERVAL).await;
        Ok(())
    }
}
