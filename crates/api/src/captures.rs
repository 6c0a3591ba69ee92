//! Captures: archives of photographs with camera poses.

use serde::{Deserialize, Serialize};

use crate::metadata::ResourceMetadata;
use crate::{CaptureId, Problem, UploadId};
use relume_spec::CaptureReport;

/// State of a capture.
///
/// `validating`: the server validates the upload, and finds camera poses if they are missing. `ready`: jobs
/// can use the capture. `invalid`: the server could not make a capture of the upload; `problem` has the
/// reason.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[derive(utoipa::ToSchema)]
pub enum CaptureState {
    /// Jobs can use the capture.
    #[default]
    Ready,
    /// The server validates the upload, and finds camera poses if they are missing.
    Validating,
    /// The server could not make a capture of the upload. `problem` has the reason. The server keeps the
    /// upload until it expires.
    Invalid,
}

/// Stage of COLMAP.
///
/// `waiting`: COLMAP works on another capture. `features`: it extracts features of each photograph.
/// `matching`: it matches features between photographs. `placing`: it registers the photographs one after the
/// other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[derive(utoipa::ToSchema)]
pub enum PosesStage {
    /// COLMAP works on another capture.
    Waiting,
    /// COLMAP extracts features of each photograph.
    Features,
    /// COLMAP matches features between photographs.
    Matching,
    /// COLMAP registers the photographs one after the other.
    Placing,
}

/// Progress of the pose estimation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct PosesProgress {
    /// Current stage.
    pub stage: PosesStage,
    /// Completed share of the stage, 0 to 1.
    pub done: f64,
}

/// A capture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = CaptureView)]
pub struct CaptureSummary {
    /// Identifier.
    #[schema(value_type = String)]
    pub id: CaptureId,
    /// SHA-256 of the archive, lower-case hex.
    pub sha256: String,
    /// Size of the archive, bytes.
    pub bytes: i64,
    /// Name, external identifier and labels.
    #[serde(flatten)]
    pub metadata: ResourceMetadata,
    /// Creation time, RFC 3339.
    pub created_at: String,
    /// State.
    #[serde(default)]
    pub state: CaptureState,
    /// Reason of the state `invalid`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub problem: Option<Problem>,
    /// Source upload, in the states `validating` and `invalid`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<String>)]
    pub upload: Option<UploadId>,
    /// Progress of the pose estimation, while it runs.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub poses: Option<PosesProgress>,
    /// SHA-256 of the uploaded file, lower-case hex, if it had no camera poses and the server found them.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub made_of: Option<String>,
    /// Report of the validation. Empty until the state is `ready`.
    pub report: CaptureReport,
}
