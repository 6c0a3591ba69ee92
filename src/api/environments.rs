//! HDR environment maps.

use serde::{Deserialize, Serialize};

use crate::api::marks::Marks;
use crate::api::{EnvironmentId, List};

/// An accepted environment map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct EnvironmentView {
    /// Identifier.
    #[cfg_attr(feature = "server", schema(value_type = String))]
    pub id: EnvironmentId,
    /// What it is called.
    #[serde(flatten)]
    pub marks: Marks,
    /// Hash of the file, lower-case hex.
    pub sha256: String,
    /// Size of the file.
    pub bytes: i64,
    /// Columns.
    pub width: i64,
    /// Rows.
    pub height: i64,
    /// What was mended, e.g. negative values set to 0.
    pub warnings: Vec<String>,
    /// RFC 3339.
    pub created_at: String,
}

/// Environment maps: those that come with the program, and a page of the uploaded ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct EnvironmentList {
    /// Names of the built-in maps.
    pub builtin: Vec<String>,
    /// Uploaded maps, newest first.
    #[serde(flatten)]
    pub uploaded: List<EnvironmentView>,
}
