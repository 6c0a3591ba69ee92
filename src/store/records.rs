//! Rows as the rest of the house sees them.

use serde::{Deserialize, Serialize};
use sqlx::FromRow;

/// Where a job stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, sqlx::Type, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
#[sqlx(rename_all = "snake_case")]
pub enum JobState {
    /// Waiting for a worker.
    Queued,
    /// A worker holds its lease.
    Running,
    /// A worker holds its lease and was asked to stop.
    Cancelling,
    /// A model was published. Terminal.
    Succeeded,
    /// It cannot be trained; the error says why. Terminal.
    Failed,
    /// Stopped on request. Terminal.
    Cancelled,
}

impl JobState {
    /// Every state, in the order of a job's life.
    pub const ALL: [Self; 6] =
        [Self::Queued, Self::Running, Self::Cancelling, Self::Succeeded, Self::Failed, Self::Cancelled];

    /// True when the state never changes again.
    pub fn is_terminal(self) -> bool {
        matches!(self, Self::Succeeded | Self::Failed | Self::Cancelled)
    }

    /// The state's name in the API and the database.
    pub fn name(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Cancelling => "cancelling",
            Self::Succeeded => "succeeded",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }
}

/// An uploaded, validated archive.
#[derive(Debug, Clone, FromRow)]
pub struct CaptureRecord {
    /// Identifier.
    pub id: String,
    /// Hash of the archive's bytes, lower-case hex.
    pub sha256: String,
    /// Size of the archive.
    pub bytes: i64,
    /// Key of the archive in the artifact store.
    pub artifact: String,
    /// What validation found, JSON.
    pub report: String,
    /// Time of upload.
    pub created_ms: i64,
}

/// An uploaded environment map.
#[derive(Debug, Clone, FromRow)]
pub struct EnvironmentRecord {
    /// Identifier.
    pub id: String,
    /// Hash of the file's bytes, lower-case hex.
    pub sha256: String,
    /// The uploader's name for it.
    pub name: Option<String>,
    /// Size of the file.
    pub bytes: i64,
    /// Key of the file in the artifact store.
    pub artifact: String,
    /// Columns.
    pub width: i64,
    /// Rows.
    pub height: i64,
    /// What was mended, JSON array of strings.
    pub warnings: String,
    /// Time of upload.
    pub created_ms: i64,
}

/// A job to be queued.
#[derive(Debug, Clone)]
pub struct NewJob {
    /// Identifier.
    pub id: String,
    /// The capture to train on.
    pub capture_id: String,
    /// The job that this one repeats.
    pub retry_of: Option<String>,
    /// Preset name.
    pub preset: String,
    /// Overrides, JSON.
    pub overrides: String,
    /// Device asked for.
    pub device: String,
    /// Higher runs first.
    pub priority: i64,
    /// Steps in all.
    pub total: i64,
}

/// A job.
#[derive(Debug, Clone, FromRow)]
pub struct JobRecord {
    /// Identifier.
    pub id: String,
    /// The capture it trains on.
    pub capture_id: String,
    /// The job that this one repeats.
    pub retry_of: Option<String>,
    /// Preset name.
    pub preset: String,
    /// Overrides, JSON.
    pub overrides: String,
    /// Device asked for.
    pub device: String,
    /// Higher runs first.
    pub priority: i64,
    /// Where it stands.
    pub state: JobState,
    /// Time of submission.
    pub created_ms: i64,
    /// Time of the first claim.
    pub started_ms: Option<i64>,
    /// Time it became terminal.
    pub finished_ms: Option<i64>,
    /// Claims so far.
    pub attempts: i64,
    /// Claims since the last stored checkpoint.
    pub idle_attempts: i64,
    /// Steps done.
    pub step: i64,
    /// Steps in all.
    pub total: i64,
    /// Objective at `step`.
    pub loss: Option<f64>,
    /// PSNR at `step`, dB.
    pub psnr: Option<f64>,
    /// Gaussians at `step`.
    pub gaussians: Option<i64>,
    /// Expected time to the end.
    pub eta_seconds: Option<f64>,
    /// What the worker is doing.
    pub message: Option<String>,
    /// Key of the last checkpoint.
    pub checkpoint: Option<String>,
    /// Step of the last checkpoint.
    pub checkpoint_step: Option<i64>,
    /// The published model.
    pub model_id: Option<String>,
    /// Stable code of the failure.
    pub error_code: Option<String>,
    /// What failed, for people.
    pub error_detail: Option<String>,
}

/// One entry of a job's history.
#[derive(Debug, Clone, PartialEq, Eq, FromRow)]
pub struct EventRecord {
    /// Grows with every event of the server.
    pub seq: i64,
    /// The job.
    pub job_id: String,
    /// When.
    pub at_ms: i64,
    /// `state`, `progress`, `checkpoint` or `warning`.
    pub kind: String,
    /// JSON object.
    pub data: String,
}

/// What a worker reports between steps.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ProgressUpdate {
    /// Steps done.
    pub step: i64,
    /// Steps in all.
    pub total: i64,
    /// The objective.
    pub loss: Option<f64>,
    /// PSNR of the last step's view, dB.
    pub psnr: Option<f64>,
    /// Gaussians now.
    pub gaussians: Option<i64>,
    /// Expected time to the end.
    pub eta_seconds: Option<f64>,
    /// What the worker is doing.
    pub message: Option<String>,
}

/// A published model.
#[derive(Debug, Clone, FromRow)]
pub struct ModelRecord {
    /// Identifier.
    pub id: String,
    /// The job that made it.
    pub job_id: String,
    /// The capture it shows.
    pub capture_id: String,
    /// Number of Gaussians.
    pub gaussians: i64,
    /// The model card, JSON.
    pub card: String,
    /// Time of publication.
    pub created_ms: i64,
}

/// A file of a published model.
#[derive(Debug, Clone, FromRow)]
pub struct ModelFile {
    /// File name, e.g. `model.safetensors`.
    pub name: String,
    /// Media type.
    pub content_type: String,
    /// Size.
    pub bytes: i64,
    /// Hash of the bytes, lower-case hex.
    pub sha256: String,
    /// Key in the artifact store.
    pub artifact: String,
}

/// A window on a list, newest first.
#[derive(Debug, Clone, Default)]
pub struct Page {
    /// Most items to return.
    pub limit: u32,
    /// Only items older than this identifier.
    pub before: Option<String>,
}
