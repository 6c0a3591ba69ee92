//! Captures: archives of posed photographs.

use serde::{Deserialize, Serialize};

use crate::api::marks::Marks;
use crate::api::{CaptureId, Problem, UploadId};
use crate::capture::CaptureReport;

/// Where a capture stands.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub enum CaptureState {
    /// Jobs may use it.
    #[default]
    Ready,
    /// It is being made of its upload.
    Validating,
    /// It could not be made of its upload, which stays for a while; `problem` says why.
    Invalid,
}

/// What COLMAP does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub enum PosesStage {
    /// Nothing yet: it works on another capture.
    Waiting,
    /// It looks for features of each photograph.
    Features,
    /// It looks for features that photographs share.
    Matching,
    /// It places the photographs one after the other.
    Placing,
}

/// How far the search for poses is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct PosesProgress {
    /// What is being done.
    pub stage: PosesStage,
    /// Share of the stage that is done, 0 to 1.
    pub done: f64,
}

/// A capture.
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
    /// Where it stands.
    #[serde(default)]
    pub state: CaptureState,
    /// Why it is invalid.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub problem: Option<Problem>,
    /// The upload that it is being made of, or could not be made of.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(value_type = Option<String>))]
    pub upload: Option<UploadId>,
    /// How far the search for the poses of its photographs is, while it lasts.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub poses: Option<PosesProgress>,
    /// Hash of the photographs that it was made of, lower-case hex, where they came without poses and the server found these.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub made_of: Option<String>,
    /// What validation found; nothing before it is `ready`.
    pub report: CaptureReport,
}
