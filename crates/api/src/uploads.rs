//! Resumable uploads.

use serde::{Deserialize, Serialize};

use crate::{CaptureId, UploadId};

/// State of an upload.
///
/// `receiving`: bytes are missing. `complete`: all bytes are stored. `validating`: the server makes a capture
/// of the upload. `invalid`: the server could not make a capture; the capture's `problem` has the reason.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[derive(utoipa::ToSchema)]
pub enum UploadState {
    /// Bytes are missing.
    #[default]
    Receiving,
    /// All bytes are stored.
    Complete,
    /// The server makes a capture of the upload.
    Validating,
    /// The server could not make a capture. The capture's `problem` has the reason.
    Invalid,
}

/// A resumable upload.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct UploadView {
    /// Identifier.
    #[schema(value_type = String)]
    pub id: UploadId,
    /// File name from `Upload-Metadata`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub filename: Option<String>,
    /// Total size, bytes.
    pub length: u64,
    /// Size of the stored part, bytes. The part is on disk.
    pub offset: u64,
    /// Creation time, RFC 3339.
    pub created_at: String,
    /// Expiry time if no more bytes arrive, RFC 3339.
    pub expires_at: String,
    /// State.
    #[serde(default)]
    pub state: UploadState,
    /// Identifier of the capture, in the states `validating` and `invalid`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<String>)]
    pub capture: Option<CaptureId>,
}

/// Source of a capture: exactly one of `upload`, `url` and `sample`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[derive(utoipa::ToSchema)]
pub struct CaptureSource {
    /// Identifier of a complete upload. The server deletes the upload when it has stored the capture.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<String>)]
    pub upload: Option<UploadId>,
    /// URL of a file that the server fetches, at most 2048 characters. The operator configures the allowed
    /// origins. The server does not follow redirects.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(max_length = 2048)]
    pub url: Option<String>,
    /// True: a small synthetic capture that the server renders, to try the service without photographs. It is
    /// the file that `relume sample` writes.
    #[serde(skip_serializing_if = "std::ops::Not::not", default)]
    pub sample: bool,
    /// Expected SHA-256 of the file, 64 hex digits. The server refuses a file with another hash. Omitted: any
    /// file.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(pattern = "^[0-9A-Fa-f]{64}$")]
    pub sha256: Option<String>,
}

impl CaptureSource {
    /// A complete upload as the source.
    pub fn upload(id: UploadId) -> Self {
        Self { upload: Some(id), ..Self::default() }
    }

    /// A file to fetch as the source.
    pub fn url(url: impl Into<String>) -> Self {
        Self { url: Some(url.into()), ..Self::default() }
    }
}
