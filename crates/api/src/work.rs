//! Workers: messages between workers and the server, and the operator's view of workers.

use serde::{Deserialize, Serialize};

use crate::jobs::NewJob;
use crate::quality::Figures;
use crate::{JobId, WorkerId};

/// Maximum number of labels of a worker, and of labels that a job requires.
pub const MAX_LABELS: usize = 16;

/// The reason why labels of a worker or of a job are invalid, if they are.
pub fn validate_labels(labels: &[String]) -> Option<String> {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-' | '/' | ':');
    if labels.len() > MAX_LABELS {
        return Some(format!("at most {MAX_LABELS} labels are allowed, got {}", labels.len()));
    }
    let is_wrong = |label: &&String| label.is_empty() || label.len() > 63 || !label.chars().all(plain);
    let wrong = labels.iter().find(is_wrong)?;
    Some(format!(
        "{wrong:?} is not a label: a label has 1 to 63 characters of A-Z, a-z, 0-9, `.`, `_`, `-`, `/` and `:`"
    ))
}

/// A worker that claims a job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct WorkerHello {
    /// Identifier that the worker generated at its start, 8 to 64 characters of A-Z, a-z, 0-9 and `-`.
    #[schema(value_type = String, min_length = 8, max_length = 64)]
    pub id: WorkerId,
    /// Display name, 1 to 200 characters without control characters.
    #[schema(min_length = 1, max_length = 200)]
    pub name: String,
    /// Name of the compute device, 1 to 200 characters without control characters.
    pub device: String,
    /// True if the device is a GPU.
    pub has_gpu: bool,
    /// Labels that jobs can require, at most 16. Labels have 1 to 63 characters of A-Z, a-z, 0-9, `.`, `_`,
    /// `-`, `/` and `:`.
    #[serde(default)]
    pub labels: Vec<String>,
    /// Version of the worker.
    pub version: String,
}

/// A claimed job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Task {
    /// Identifier of the job.
    #[schema(value_type = String)]
    pub job: JobId,
    /// The submitted request.
    pub request: NewJob,
    /// Number of this attempt, from 1.
    pub attempt: i64,
    /// True if the server makes no further attempt when this one fails without a new checkpoint.
    pub is_last_attempt: bool,
    /// Total number of steps.
    pub total: i64,
    /// Step of the checkpoint to continue from, if there is one.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub checkpoint_step: Option<i64>,
    /// W3C `traceparent` of the request that submitted the job. The attempt is a span of that trace.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub traceparent: Option<String>,
}

/// The answer to a claim.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Claimed {
    /// The claimed job. Absent if there is no job for this worker.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub task: Option<Task>,
    /// Lease token of the job. The worker sends it in the header `Relume-Lease` of every request about the
    /// job.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub lease: Option<String>,
    /// True if the worker must exit because the server gives it no more jobs.
    pub draining: bool,
    /// Interval of the heartbeats of a worker with a job, milliseconds.
    pub beat_ms: u64,
}

/// Status of a lease.
///
/// `held`: valid. `cancelling`: valid, and the job was asked to stop. `lost`: expired or revoked; the worker
/// must stop and publish nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LeaseStatus {
    /// The lease is valid.
    Held,
    /// The lease is valid and the job was asked to stop.
    Cancelling,
    /// The lease expired or was revoked. The worker must stop and publish nothing.
    Lost,
}

/// Reason of a worker to return a job to the queue.
///
/// `shutdown`: the worker stops. `outage`: a service that the worker needs is unreachable. `no_room`: the
/// disk is full; the job waits for disk space. `preempted`: a job of another tenant, or one of a higher
/// priority, runs first. `attempt_failed`: the attempt failed, and another one may succeed. Only
/// `attempt_failed` counts as an attempt without a checkpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Release {
    /// The worker stops. The attempt does not count as an attempt without a checkpoint.
    Shutdown,
    /// A service that the worker needs is unreachable. The attempt does not count.
    Outage,
    /// The disk is full. The job waits for disk space. The attempt does not count.
    NoRoom,
    /// A job of another tenant, or one of a higher priority, runs first. The attempt does not count.
    Preempted,
    /// The attempt failed. Another one may succeed.
    AttemptFailed,
}

/// Status of the lease of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct LeaseView {
    /// Status.
    pub status: LeaseStatus,
    /// Only in the answer to a heartbeat. True if a job of another tenant without a running job, or one of a
    /// higher priority, waits for this worker. After its time slice, the worker should store a checkpoint and
    /// return its job with the reason `preempted`.
    #[serde(skip_serializing_if = "std::ops::Not::not", default)]
    pub should_yield: bool,
}

/// A warning for the event history of the job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct WorkWarning {
    /// Text for the user. The server truncates it to 2,000 characters.
    pub message: String,
}

/// End of an attempt without a model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case", tag = "how", deny_unknown_fields)]
pub enum WorkEnd {
    /// The job returns to the queue.
    Released {
        /// Reason.
        why: Release,
    },
    /// The job failed.
    Failed {
        /// Stable code.
        code: String,
        /// A description for the user.
        detail: String,
    },
    /// The job stopped as requested.
    Cancelled,
}

/// A trained model to publish. The worker has sent its files before.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FinishedModel {
    /// Number of Gaussians.
    pub gaussians: i64,
    /// The model card.
    #[schema(value_type = Object)]
    pub card: serde_json::Value,
    /// Figures measured on held-out views.
    pub figures: Figures,
    /// The sent files.
    pub files: Vec<SentFile>,
}

/// A file of a model that a worker has sent.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SentFile {
    /// Name, e.g. `model.safetensors`.
    pub name: String,
    /// SHA-256, lower-case hex.
    pub sha256: String,
    /// Size, bytes.
    pub bytes: u64,
}

/// State of a worker.
///
/// `idle`: waits for a job. `working`: works on a job. `draining`: gets no more jobs, and may still work on
/// one. `lost`: sent no heartbeat for a minute; its job goes to another worker.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum WorkerState {
    /// The worker waits for a job.
    Idle,
    /// The worker works on a job.
    Working,
    /// The worker gets no more jobs. It may still work on one.
    Draining,
    /// The worker sent no heartbeat for a minute. Its job goes to another worker.
    Lost,
}

impl WorkerState {
    /// All states.
    pub const ALL: [Self; 4] = [Self::Idle, Self::Working, Self::Draining, Self::Lost];

    /// Name in the API.
    pub fn name(self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::Working => "working",
            Self::Draining => "draining",
            Self::Lost => "lost",
        }
    }
}

/// A worker, as the operator sees it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct WorkerView {
    /// Identifier.
    #[schema(value_type = String)]
    pub id: WorkerId,
    /// Display name.
    pub name: String,
    /// True for a local worker, a thread of a server. False for a remote worker, a separate process.
    pub in_server: bool,
    /// Name of the compute device, 1 to 200 characters without control characters.
    pub device: String,
    /// True if the device is a GPU.
    pub has_gpu: bool,
    /// Labels that jobs can require.
    pub labels: Vec<String>,
    /// Version of the worker.
    pub version: String,
    /// State.
    pub state: WorkerState,
    /// True if the worker gets no more jobs.
    pub draining: bool,
    /// Identifier of the current job.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<String>)]
    pub job: Option<JobId>,
    /// Start time, RFC 3339.
    pub started_at: String,
    /// Time of the last heartbeat, RFC 3339.
    pub seen_at: String,
}

/// A change of a worker.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct WorkerChange {
    /// `true`: the worker gets no more jobs; a remote worker then exits. `false`: the worker gets jobs again.
    pub draining: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worker_labels_are_limited_in_number_and_characters() {
        let fault =
            |labels: &[&str]| validate_labels(&labels.iter().map(|l| (*l).to_owned()).collect::<Vec<_>>());
        assert_eq!(fault(&["a6000", "site:berlin", "vram/48"]), None);
        assert!(fault(&["a b"]).is_some_and(|why| why.contains("a b")));
        assert!(fault(&[""]).is_some());
        assert!(fault(&["x"; 17]).is_some_and(|why| why.contains("17")));
    }
}
