//! Models: what trainings produced.

use serde::{Deserialize, Serialize};

use crate::api::marks::Marks;
use crate::api::{CaptureId, JobId, ModelId};

/// A model in a list.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct ModelSummary {
    /// Identifier.
    #[cfg_attr(feature = "server", schema(value_type = String))]
    pub id: ModelId,
    /// The job that made it; it may have been deleted since.
    #[cfg_attr(feature = "server", schema(value_type = String))]
    pub job: JobId,
    /// The capture it shows; it may have been deleted since.
    #[cfg_attr(feature = "server", schema(value_type = String))]
    pub capture: CaptureId,
    /// Number of Gaussians.
    pub gaussians: i64,
    /// What it is called.
    #[serde(flatten)]
    pub marks: Marks,
    /// RFC 3339.
    pub created_at: String,
}

/// A model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct ModelView {
    /// What a list shows.
    #[serde(flatten)]
    pub summary: ModelSummary,
    /// Its files.
    pub files: Vec<FileView>,
    /// What was trained, how, and what was decided on what evidence.
    #[cfg_attr(feature = "server", schema(value_type = Object))]
    pub card: serde_json::Value,
}

/// A file of a model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct FileView {
    /// Name, e.g. `model.ply`.
    pub name: String,
    /// Media type.
    pub content_type: String,
    /// Size.
    pub bytes: i64,
    /// Hash, lower-case hex; also the file's `ETag`.
    pub sha256: String,
    /// Path to get it at.
    pub href: String,
}
