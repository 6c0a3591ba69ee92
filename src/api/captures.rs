//! Captures: archives of posed photographs.

use serde::{Deserialize, Serialize};

use crate::api::CaptureId;
use crate::api::marks::Marks;
use crate::capture::CaptureReport;

/// An accepted capture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema), schema(as = CaptureView))]
pub struct CaptureSummary {
    /// Identifier.
    #[cfg_attr(feature = "server", schema(value_type = String))]
    pub id: CaptureId,
    /// Hash of the archive, lower-case hex.
    pub sha256: String,
    /// Size of the archive.
    pub bytes: i64,
    /// What it is called.
    #[serde(flatten)]
    pub marks: Marks,
    /// RFC 3339.
    pub created_at: String,
    /// What validation found.
    pub report: CaptureReport,
}
