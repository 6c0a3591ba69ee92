//! What errors of the API are to a worker.

use crate::client::ClientError;
use crate::worker::SourceError;

/// What an error of the API is to a worker.
pub(super) fn source_error(error: ClientError) -> SourceError {
    let Some(problem) = error.problem() else {
        return match error {
            ClientError::Transport(error) => SourceError::Unreachable(format!("the server: {error}")),
            error => SourceError::Failed(error.to_string()),
        };
    };
    match problem.kind.rsplit(':').next().unwrap_or_default() {
        "not-found" => SourceError::Gone,
        "artifact-damaged" => SourceError::Damaged,
        "insufficient-storage" | "storage-limit" | "quota-exceeded" => SourceError::Full,
        _ if matches!(problem.status, 408 | 429 | 502..=504) => SourceError::Unreachable(error.to_string()),
        _ => SourceError::Failed(error.to_string()),
    }
}
