//! HDR environment maps.

use serde::{Deserialize, Serialize};

use crate::metadata::ResourceMetadata;
use crate::{EnvironmentId, List};

/// A stored environment map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct EnvironmentView {
    /// Identifier.
    #[schema(value_type = String)]
    pub id: EnvironmentId,
    /// Name, external identifier and labels.
    #[serde(flatten)]
    pub metadata: ResourceMetadata,
    /// SHA-256 of the file, lower-case hex.
    pub sha256: String,
    /// Size of the file, bytes.
    pub bytes: i64,
    /// Width, pixels.
    pub width: i64,
    /// Height, pixels.
    pub height: i64,
    /// Corrections made at import, e.g. negative values set to 0.
    pub warnings: Vec<String>,
    /// Creation time, RFC 3339.
    pub created_at: String,
}

/// Built-in environment maps, and a page of the uploaded ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct EnvironmentList {
    /// Names of the built-in maps.
    pub builtin: Vec<String>,
    /// Uploaded maps, newest first.
    #[serde(flatten)]
    pub uploaded: List<EnvironmentView>,
}
