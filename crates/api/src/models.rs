//! Models: the results of trainings.

use serde::{Deserialize, Serialize};

use crate::calibration::CalibrationView;
use crate::metadata::ResourceMetadata;
use crate::{CaptureId, JobId, ModelId};

/// A model as lists show it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ModelSummary {
    /// Identifier.
    #[schema(value_type = String)]
    pub id: ModelId,
    /// Identifier of the job that trained the model. The job may be deleted.
    #[schema(value_type = String)]
    pub job: JobId,
    /// Identifier of the capture. The capture may be deleted.
    #[schema(value_type = String)]
    pub capture: CaptureId,
    /// Number of Gaussians.
    pub gaussians: i64,
    /// Name, external identifier and labels.
    #[serde(flatten)]
    pub metadata: ResourceMetadata,
    /// Creation time, RFC 3339.
    pub created_at: String,
}

/// A model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ModelView {
    /// The fields that lists show.
    #[serde(flatten)]
    pub summary: ModelSummary,
    /// Files.
    pub files: Vec<FileView>,
    /// The calibration by a surface of known reflectance. Absent if there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<CalibrationView>,
    /// Model card: training input, settings, and decisions with their evidence.
    #[schema(value_type = Object)]
    pub card: serde_json::Value,
}

/// A file of a model or an export.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct FileView {
    /// Name, e.g. `model.ply`.
    pub name: String,
    /// Media type.
    pub content_type: String,
    /// Size, bytes.
    pub bytes: i64,
    /// SHA-256, lower-case hex. Also the `ETag` of the file.
    pub sha256: String,
    /// Path of the file on this server.
    pub href: String,
}
