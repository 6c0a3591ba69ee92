//! Rows of exports.

use sqlx::FromRow;
use sqlx::types::Json;

use crate::store::job_view::rfc3339;
use crate::store::page::paginated;
use relume_api::exports::{ExportKind, ExportProgress, ExportState, ExportView, NewExport};
use relume_api::jobs::JobError;
use relume_api::models::FileView;
use relume_api::{ExportId, ModelId, TenantId};

/// The folder of finished exports among the artifacts, and of the work folders in the data directory.
pub(in crate::store) const EXPORTS: &str = "exports";

/// Maximum length of a request that views contain, bytes of JSON. The column `short_request` of queries has the same limit.
const MAX_SHOWN_REQUEST: usize = 4096;

/// An export.
#[derive(Debug, Clone, FromRow)]
pub struct ExportRecord {
    /// Identifier.
    pub id: ExportId,
    /// The tenant.
    pub tenant: TenantId,
    /// The exported model.
    pub model_id: ModelId,
    /// Kind of the export.
    pub kind: ExportKind,
    /// The request, if it is short and the query selects it.
    #[sqlx(default)]
    pub short_request: Option<Json<NewExport>>,
    /// State of the export.
    pub state: ExportState,
    /// Progress of the export.
    #[sqlx(flatten)]
    pub progress: ExportProgress,
    /// Name of the finished file.
    pub file_name: Option<String>,
    /// Media type of the finished file.
    pub content_type: Option<String>,
    /// Key of the finished file in the artifact store.
    pub artifact: Option<String>,
    /// Size of the finished file, bytes.
    pub bytes: Option<i64>,
    /// Hash of its bytes, lower-case hex.
    pub sha256: Option<String>,
    /// Stable code of the failure.
    pub error_code: Option<String>,
    /// Description of the failure.
    pub error_detail: Option<String>,
    /// Time of submission.
    pub created_ms: i64,
    /// Time of the first claim.
    pub started_ms: Option<i64>,
    /// Time at which it ended.
    pub finished_ms: Option<i64>,
}

impl ExportRecord {
    /// A queued export of a tenant, with `total` steps.
    pub fn queued(
        tenant: TenantId,
        id: ExportId,
        model_id: ModelId,
        (request, total): (&NewExport, i64),
        created_ms: i64,
    ) -> Self {
        let is_short = serde_json::to_vec(request).is_ok_and(|json| json.len() <= MAX_SHOWN_REQUEST);
        Self {
            id,
            tenant,
            model_id,
            kind: request.kind(),
            short_request: is_short.then(|| Json(request.clone())),
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

    /// The export as the API shows it.
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
            request: self.short_request.map(|Json(request)| request),
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

/// A claimed export.
#[derive(Debug, Clone, FromRow)]
pub struct ClaimedExport {
    /// Its record.
    #[sqlx(flatten)]
    pub record: ExportRecord,
    /// The request.
    #[sqlx(json)]
    pub request: NewExport,
}

/// The finished file of an export.
#[derive(Debug, Clone)]
pub struct ExportedFile {
    /// Path of the file, in the work folder of the export.
    pub path: std::path::PathBuf,
    /// File name, ASCII.
    pub name: String,
    /// Media type.
    pub content_type: &'static str,
}

paginated!(ExportRecord: created_ms);
