//! Rows of exports.

use sqlx::FromRow;

use crate::store::job_view::rfc3339;
use crate::store::page::paginated;
use relume_api::exports::{ExportKind, ExportProgress, ExportState, ExportView, NewExport};
use relume_api::jobs::JobError;
use relume_api::models::FileView;
use relume_api::{ExportId, ModelId, TenantId};

/// The folder of finished exports among the artifacts, and of their work folders in the data directory.
pub(in crate::store) const EXPORTS: &str = "exports";

/// An export without what was asked for, which may be long.
#[derive(Debug, Clone, FromRow)]
pub struct ExportRecord {
    /// Identifier.
    pub id: ExportId,
    /// Whose it is.
    pub tenant: TenantId,
    /// The model that it is made of.
    pub model_id: ModelId,
    /// What is made.
    pub kind: ExportKind,
    /// Where it stands.
    pub state: ExportState,
    /// How much is done.
    #[sqlx(flatten)]
    pub progress: ExportProgress,
    /// Name of the finished file.
    pub file_name: Option<String>,
    /// Media type of the finished file.
    pub content_type: Option<String>,
    /// Key of the finished file in the artifact store.
    pub artifact: Option<String>,
    /// Its size.
    pub bytes: Option<i64>,
    /// Hash of its bytes, lower-case hex.
    pub sha256: Option<String>,
    /// Stable code of the failure.
    pub error_code: Option<String>,
    /// What failed, for people.
    pub error_detail: Option<String>,
    /// Time of submission.
    pub created_ms: i64,
    /// Time of the first claim.
    pub started_ms: Option<i64>,
    /// Time it became terminal.
    pub finished_ms: Option<i64>,
}

impl ExportRecord {
    /// One of a tenant that waits.
    pub fn queued(
        tenant: TenantId,
        id: ExportId,
        model_id: ModelId,
        (kind, total): (ExportKind, i64),
        created_ms: i64,
    ) -> Self {
        Self {
            id,
            tenant,
            model_id,
            kind,
            state: ExportState::Queued,
            progress: ExportProgress { done: 0, total },
            file_name: None,
            content_type: None,
            artifact: None,
            bytes: None,
            sha256: None,
            error_code: None,
            error_detail: None,
            created_ms,
            started_ms: None,
            finished_ms: None,
        }
    }

    /// As the API shows it.
    pub fn view(self) -> ExportView {
        let detail = self.error_detail.unwrap_or_default();
        let href = format!("/v1/exports/{}/file", self.id);
        let file = self.artifact.and(Some(FileView {
            name: self.file_name.unwrap_or_default(),
            content_type: self.content_type.unwrap_or_default(),
            bytes: self.bytes.unwrap_or_default(),
            sha256: self.sha256.unwrap_or_default(),
            href,
        }));
        ExportView {
            id: self.id,
            model: self.model_id,
            kind: self.kind,
            state: self.state,
            progress: self.progress,
            file,
            error: self.error_code.map(|code| JobError { code, detail }),
            created_at: rfc3339(self.created_ms),
            started_at: self.started_ms.map(rfc3339),
            finished_at: self.finished_ms.map(rfc3339),
        }
    }
}

/// An export that is being made.
#[derive(Debug, Clone, FromRow)]
pub struct ClaimedExport {
    /// Its row.
    #[sqlx(flatten)]
    pub record: ExportRecord,
    /// What was asked for.
    #[sqlx(json)]
    pub request: NewExport,
}

/// The file that was made of an export.
#[derive(Debug, Clone)]
pub struct ExportedFile {
    /// Where it is; in the work folder of the export.
    pub path: std::path::PathBuf,
    /// What it is called, ASCII.
    pub name: String,
    /// Media type.
    pub content_type: &'static str,
}

paginated!(ExportRecord: created_ms);
