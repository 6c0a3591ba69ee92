//! Maps errors of the API to errors of a job source.

use crate::worker::JobSourceError;
use relume_client::ClientError;

/// Maps an error of the API to an error of a job source.
pub(super) fn source_error(error: ClientError) -> JobSourceError {
    let Some(problem) = error.problem() else {
        return match error {
            ClientError::Transport(error) => JobSourceError::Unreachable(format!("the server: {error}")),
            error => JobSourceError::Failed(error.to_string()),
        };
    };
    match problem.kind.rsplit(':').next().unwrap_or_default() {
        "not-found" => JobSourceError::Gone,
        "artifact-damaged" => JobSourceError::Damaged,
        "insufficient-storage" | "storage-limit" | "quota-exceeded" => JobSourceError::Full,
        _ if matches!(problem.status, 408 | 429 | 502..=504) => {
            JobSourceError::Unreachable(error.to_string())
        }
        _ => JobSourceError::Failed(error.to_string()),
    }
}
