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
    /// Metadata.
    #[sqlx(flatten)]
    pub metadata: ResourceMetadata,
    /// The result of validation.
    #[sqlx(json)]
    pub report: CaptureReport,
    /// Time of upload.
    pub created_ms: i64,
    /// Hash of the source photographs without poses, lower-case hex.
    pub made_of: Option<String>,
}

/// An uploaded environment map.
#[derive(Debug, Clone, FromRow)]
pub struct EnvironmentRecord {
    /// Identifier.
    pub id: EnvironmentId,
    /// Hash of the file's bytes, lower-case hex.
    pub sha256: String,
    /// Metadata.
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
    /// Warnings about corrected values.
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
    /// The tenant.
    pub tenant: TenantId,
    /// The request.
    #[sqlx(flatten)]
    pub request: NewJob,
    /// The job that this job retries.
    pub retry_of: Option<JobId>,
    /// The trace of the request that created the job, as a W3C `traceparent`. It is for operators; clients do not see it.
    pub traceparent: Option<String>,
    /// State of the job.
    pub state: JobState,
    /// Time of submission.
    pub created_ms: i64,
    /// Time of the first claim.
    pub started_ms: Option<i64>,
    /// Time at which it ended.
    pub finished_ms: Option<i64>,
    /// The worker that runs the job or ran it last.
    pub worker: Option<WorkerId>,
    /// Number of claims so far.
    pub attempts: i64,
    /// Number of claims since the last stored checkpoint.
    pub idle_attempts: i64,
    /// Progress of the training.
    #[sqlx(flatten)]
    pub progress: JobProgress,
    /// Key of the last checkpoint.
    pub checkpoint: Option<String>,
    /// Hash of the last checkpoint's bytes, lower-case hex; `None` for checkpoints of versions that did not store it.
    pub checkpoint_sha256: Option<String>,
    /// Step of the last checkpoint.
    pub checkpoint_step: Option<i64>,
    /// The accuracy of the model.
    #[sqlx(json(nullable))]
    pub figures: Option<Figures>,
    /// The published model.
    pub model_id: Option<ModelId>,
    /// Time at which the model was deleted.
    pub model_deleted_ms: Option<i64>,
    /// Stable code of the failure.
    pub error_code: Option<String>,
    /// Description of the failure.
    pub error_detail: Option<String>,
}

impl JobRecord {
    /// A queued job of a tenant with `total` steps.
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
    /// Number in the order of all events of the server.
    pub seq: i64,
    /// The job.
    pub job_id: JobId,
    /// Time of the event.
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
    /// The capture that it was trained on.
    pub capture_id: CaptureId,
    /// Number of Gaussians.
    pub gaussians: i64,
    /// Metadata.
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
    /// Size, bytes.
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
    /// Descriptive name.
    pub name: String,
    /// The tenant.
    pub tenant: TenantId,
    /// The permitted scopes.
    #[sqlx(json)]
    pub scopes: Vec<Scope>,
    /// Hash of the whole key, lower-case hex.
    pub secret_sha256: String,
    /// The key of the creator.
    pub made_by: Option<KeyId>,
    /// Time of creation.
    pub created_ms: i64,
    /// Expiry time.
    pub expires_ms: Option<i64>,
    /// Time of the last use, with a resolution of a minute.
    pub last_used_ms: Option<i64>,
    /// Time of revocation.
    pub revoked_ms: Option<i64>,
}

impl KeyRecord {
    /// Whether the key is neither revoked nor expired.
    pub fn is_valid(&self, now_ms: i64) -> bool {
        self.revoked_ms.is_none() && self.expires_ms.is_none_or(|end| now_ms < end)
    }
}

paginated!(CaptureRecord: created_ms, EnvironmentRecord: created_ms, JobRecord: created_ms);
paginated!(ModelRecord: created_ms, KeyRecord: created_ms);
