//! Workers: what they and the server tell each other, and what operators see of them.

use serde::{Deserialize, Serialize};

use crate::api::jobs::NewJob;
use crate::api::quality::Figures;
use crate::api::{JobId, WorkerId};

/// Most labels of a worker and of a job.
pub const MOST_LABELS: usize = 16;

/// What is wrong with the labels of a worker, or with those that a job asks for, if anything is.
pub fn fault_of_labels(labels: &[String]) -> Option<String> {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-' | '/' | ':');
    if labels.len() > MOST_LABELS {
        return Some(format!("at most {MOST_LABELS} labels, got {}", labels.len()));
    }
    let is_wrong = |label: &&String| label.is_empty() || label.len() > 63 || !label.chars().all(plain);
    let wrong = labels.iter().find(is_wrong)?;
    Some(format!("{wrong:?} is no label: 1 to 63 of A-Z, a-z, 0-9, `.`, `_`, `-`, `/` and `:`"))
}

/// A worker that asks for a job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct WorkerHello {
    /// Identifier that the worker made up when it started, 8 to 64 of A-Z, a-z, 0-9 and `-`.
    #[cfg_attr(feature = "server", schema(value_type = String, min_length = 8, max_length = 64))]
    pub id: WorkerId,
    /// A name for people, 1 to 200 characters, none of them control characters.
    #[cfg_attr(feature = "server", schema(min_length = 1, max_length = 200))]
    pub name: String,
    /// What it computes on.
    pub device: String,
    /// Whether that is a GPU.
    pub has_gpu: bool,
    /// What jobs may ask for, at most 16.
    #[serde(default)]
    pub labels: Vec<String>,
    /// Its version.
    pub version: String,
}

/// A job as the worker that holds it sees it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct Task {
    /// The job.
    #[cfg_attr(feature = "server", schema(value_type = String))]
    pub job: JobId,
    /// What was asked for.
    pub request: NewJob,
    /// Which attempt this is, from 1.
    pub attempt: i64,
    /// Whether another that fails without a checkpoint is not made.
    pub is_last_attempt: bool,
    /// Steps in all.
    pub total: i64,
    /// Step of the checkpoint to go on from, if there is one.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub checkpoint_step: Option<i64>,
    /// The trace of the request that made the job, as a W3C `traceparent`: the attempt is a span of it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub traceparent: Option<String>,
}

/// The answer to a worker that asks for a job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct Claimed {
    /// The job, if one waits that this worker may have.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub task: Option<Task>,
    /// The lease on it; sent in `Relume-Lease` with everything about it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub lease: Option<String>,
    /// Whether the worker shall end: it will be given no job.
    pub draining: bool,
    /// How often a worker with a job shall say that it is there, milliseconds.
    pub beat_ms: u64,
}

/// What a worker's message about a job found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum LeaseStatus {
    /// The lease is valid.
    Held,
    /// The lease is valid and the job was asked to stop.
    Cancelling,
    /// The lease ran out or was taken back: stop and publish nothing.
    Lost,
}

/// Why a worker gives a job back to the queue.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Release {
    /// The worker stops; the attempt does not count as one without a checkpoint.
    Shutdown,
    /// What the worker needs could not be reached; the attempt does not count either.
    Outage,
    /// There is no room on the disk; the job waits for some. Does not count either.
    NoRoom,
    /// The attempt failed and another may succeed.
    AttemptFailed,
}

/// How the lease on a job stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct LeaseView {
    /// How it stands.
    pub status: LeaseStatus,
}

/// A warning for the job's history.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct WorkWarning {
    /// What to look out for, at most 2,000 characters.
    pub message: String,
}

/// How an attempt ended without a model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case", tag = "how", deny_unknown_fields)]
pub enum WorkEnd {
    /// The job goes back to the queue.
    Released {
        /// Why.
        why: Release,
    },
    /// The job has failed.
    Failed {
        /// Stable code.
        code: String,
        /// A description for the user.
        detail: String,
    },
    /// The job was asked to stop and has.
    Cancelled,
}

/// A model that is finished; its files were sent before.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct FinishedModel {
    /// Number of Gaussians.
    pub gaussians: i64,
    /// The model card.
    #[cfg_attr(feature = "server", schema(value_type = Object))]
    pub card: serde_json::Value,
    /// What was measured on held-out views.
    pub figures: Figures,
    /// The files.
    pub files: Vec<SentFile>,
}

/// A file of a model that a worker has sent.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct SentFile {
    /// Its name, e.g. `model.safetensors`.
    pub name: String,
    /// Hash of its bytes, lower-case hex.
    pub sha256: String,
    /// Its size.
    pub bytes: u64,
}

/// Where a worker stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum WorkerState {
    /// It waits for a job.
    Idle,
    /// It works on a job.
    Working,
    /// It is given no more jobs; it may still work on one.
    Draining,
    /// It was not heard of for a minute: its job is given to another.
    Lost,
}

impl WorkerState {
    /// Every state.
    pub const ALL: [Self; 4] = [Self::Idle, Self::Working, Self::Draining, Self::Lost];

    /// Its name in the API.
    pub fn name(self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::Working => "working",
            Self::Draining => "draining",
            Self::Lost => "lost",
        }
    }
}

/// A worker, for whoever runs the server.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct WorkerView {
    /// Identifier.
    #[cfg_attr(feature = "server", schema(value_type = String))]
    pub id: WorkerId,
    /// A name for people.
    pub name: String,
    /// Whether it is a thread of a server; otherwise it is a process of its own.
    pub in_server: bool,
    /// What it computes on.
    pub device: String,
    /// Whether that is a GPU.
    pub has_gpu: bool,
    /// What jobs may ask for.
    pub labels: Vec<String>,
    /// Its version.
    pub version: String,
    /// Where it stands.
    pub state: WorkerState,
    /// Whether it is given no more jobs.
    pub draining: bool,
    /// The job that it works on.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(value_type = Option<String>))]
    pub job: Option<JobId>,
    /// RFC 3339.
    pub started_at: String,
    /// RFC 3339; when it was heard of last.
    pub seen_at: String,
}

/// What may be changed about a worker.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct WorkerChange {
    /// Whether it is given no more jobs. One with a process of its own then ends.
    pub draining: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_short_plain_words() {
        let fault =
            |labels: &[&str]| fault_of_labels(&labels.iter().map(|l| (*l).to_owned()).collect::<Vec<_>>());
        assert_eq!(fault(&["a6000", "site:berlin", "vram/48"]), None);
        assert!(fault(&["a b"]).is_some_and(|why| why.contains("a b")));
        assert!(fault(&[""]).is_some());
        assert!(fault(&["x"; 17]).is_some_and(|why| why.contains("17")));
    }
}
