//! Rows of the database.

use sqlx::FromRow;

use crate::store::page::paginated;
use relume_api::jobs::{JobProgress, JobState, NewJob};
use relume_api::keys::Scope;
use relume_api::metadata::ResourceMetadata;
use relume_api::quality::Figures;
use relume_api::{CaptureId, EnvironmentId, JobId, KeyId, ModelId, TenantId, WorkerId};
use relume_spec::CaptureReport;

/// An uploaded, validated archive.
#[derive(Debug, Clone, FromRow)]
pub struct CaptureRecord {
    /// Identifier.
    pub id: CaptureId,
    /// Hash of the archive's bytes, lower-case hex.
    pub sha256: String,
    /// Size of the archive.
    pub bytes: i64,
    /// Key of the archive in the artifact store.
    pub artifact: String,
    /// What it is called.
    #[sqlx(flatten)]
    pub metadata: ResourceMetadata,
    /// What validation found.
    #[sqlx(json)]
    pub report: CaptureReport,
    /// Time of upload.
    pub created_ms: i64,
    /// Hash of the photographs without poses that it was made of, lower-case hex.
    pub made_of: Option<String>,
}

/// An uploaded environment map.
#[derive(Debug, Clone, FromRow)]
pub struct EnvironmentRecord {
    /// Identifier.
    pub id: EnvironmentId,
    /// Hash of the file's bytes, lower-case hex.
    pub sha256: String,
    /// What it is called.
    #[sqlx(flatten)]
    pub metadata: ResourceMetadata,
    /// Size of the file.
    pub bytes: i64,
    /// Key of the file in the artifact store.
    pub artifact: String,
    /// Columns.
    pub width: i64,
    /// Rows.
    pub height: i64,
    /// What was mended.
    #[sqlx(json)]
    pub warnings: Vec<String>,
    /// Time of upload.
    pub created_ms: i64,
}

/// A job.
#[derive(Debug, Clone, FromRow)]
pub struct JobRecord {
    /// Identifier.
    pub id: JobId,
    /// Whose it is.
    pub tenant: TenantId,
    /// What was asked for.
    #[sqlx(flatten)]
    pub request: NewJob,
    /// The job that this one repeats.
    pub retry_of: Option<JobId>,
    /// The trace of the request that made it, as a W3C `traceparent`. For operators: clients do not see it.
    pub traceparent: Option<String>,
    /// Where it stands.
    pub state: JobState,
    /// Time of submission.
    pub created_ms: i64,
    /// Time of the first claim.
    pub started_ms: Option<i64>,
    /// Time it became terminal.
    pub finished_ms: Option<i64>,
    /// The worker that has it or had it last.
    pub worker: Option<WorkerId>,
    /// Claims so far.
    pub attempts: i64,
    /// Claims since the last stored checkpoint.
    pub idle_attempts: i64,
    /// Progress of the training.
    #[sqlx(flatten)]
    pub progress: JobProgress,
    /// Key of the last checkpoint.
    pub checkpoint: Option<String>,
    /// Hash of the last checkpoint's bytes, lower-case hex; none of checkpoints from before it was kept.
    pub checkpoint_sha256: Option<String>,
    /// Step of the last checkpoint.
    pub checkpoint_step: Option<i64>,
    /// What was measured of its model.
    #[sqlx(json(nullable))]
    pub figures: Option<Figures>,
    /// The published model.
    pub model_id: Option<ModelId>,
    /// When that model was deleted.
    pub model_deleted_ms: Option<i64>,
    /// Stable code of the failure.
    pub error_code: Option<String>,
    /// What failed, for people.
    pub error_detail: Option<String>,
}

impl JobRecord {
    /// A job of `total` steps of a tenant that waits for a worker.
    pub fn queued(tenant: TenantId, id: JobId, request: NewJob, total: i64, created_ms: i64) -> Self {
        Self {
            id,
            tenant,
            request,
            retry_of: None,
            traceparent: None,
            state: JobState::Queued,
            created_ms,
            started_ms: None,
            finished_ms: None,
            worker: None,
            attempts: 0,
            idle_attempts: 0,
            progress: JobProgress { total, ..JobProgress::default() },
            checkpoint: None,
            checkpoint_sha256: None,
            checkpoint_step: None,
            figures: None,
            model_id: None,
            model_deleted_ms: None,
            error_code: None,
            error_detail: None,
        }
    }
}

/// One entry of a job's history.
#[derive(Debug, Clone, PartialEq, Eq, FromRow)]
pub struct EventRecord {
    /// Grows with every event of the server.
    pub seq: i64,
    /// The job.
    pub job_id: JobId,
    /// When.
    pub at_ms: i64,
    /// `state`, `progress`, `checkpoint` or `warning`.
    pub kind: String,
    /// JSON object.
    pub data: String,
}

/// A published model.
#[derive(Debug, Clone, FromRow)]
pub struct ModelRecord {
    /// Identifier.
    pub id: ModelId,
    /// The job that made it.
    pub job_id: JobId,
    /// The capture it shows.
    pub capture_id: CaptureId,
    /// Number of Gaussians.
    pub gaussians: i64,
    /// What it is called.
    #[sqlx(flatten)]
    pub metadata: ResourceMetadata,
    /// The model card.
    #[sqlx(json)]
    pub card: serde_json::Value,
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

/// An API key.
#[derive(Debug, Clone, FromRow)]
pub struct KeyRecord {
    /// Identifier.
    pub id: KeyId,
    /// A name for people.
    pub name: String,
    /// Whose it is.
    pub tenant: TenantId,
    /// What it may do.
    #[sqlx(json)]
    pub scopes: Vec<Scope>,
    /// Hash of the key's text, lower-case hex.
    pub secret_sha256: String,
    /// The key that made it.
    pub made_by: Option<KeyId>,
    /// When it was made.
    pub created_ms: i64,
    /// When it expires.
    pub expires_ms: Option<i64>,
    /// When it was used last, to a minute.
    pub last_used_ms: Option<i64>,
    /// When it was revoked.
    pub revoked_ms: Option<i64>,
}

impl KeyRecord {
    /// Whether it can be used.
    pub fn is_valid(&self, now_ms: i64) -> bool {
        self.revoked_ms.is_none() && self.expires_ms.is_none_or(|end| now_ms < end)
    }
}

paginated!(CaptureRecord: created_ms, EnvironmentRecord: created_ms, JobRecord: created_ms);
paginated!(ModelRecord: created_ms, KeyRecord: created_ms);
