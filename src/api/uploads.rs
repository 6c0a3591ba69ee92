//! Uploads that arrive in pieces.

use serde::{Deserialize, Serialize};

use crate::api::{CaptureId, UploadId};

/// Where an upload stands.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub enum UploadState {
    /// Not all of its bytes have arrived.
    #[default]
    Receiving,
    /// All of its bytes have arrived.
    Complete,
    /// A capture is being made of it.
    Validating,
    /// No capture could be made of it; the capture says why.
    Invalid,
}

/// An upload that arrives in pieces.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct UploadView {
    /// Identifier.
    #[cfg_attr(feature = "server", schema(value_type = String))]
    pub id: UploadId,
    /// The name that came with it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub filename: Option<String>,
    /// Bytes when it is complete.
    pub length: u64,
    /// Bytes that have arrived and are on disk.
    pub offset: u64,
    /// When it was begun, RFC 3339.
    pub created_at: String,
    /// When it is given up if nothing more comes, RFC 3339.
    pub expires_at: String,
    /// Where it stands.
    #[serde(default)]
    pub state: UploadState,
    /// The capture that is being made of it, or could not be made.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(value_type = Option<String>))]
    pub capture: Option<CaptureId>,
}

/// Names what a capture is to be made of: a complete upload, or a file to fetch.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct CaptureSource {
    /// The upload.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(value_type = Option<String>))]
    pub upload: Option<UploadId>,
    /// Where the file is. The server's operator says from where it fetches; redirects are not followed.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(max_length = 2048))]
    pub url: Option<String>,
    /// SHA-256 of the file, hex: nothing else is accepted.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(pattern = "^[0-9A-Fa-f]{64}$"))]
    pub sha256: Option<String>,
}

impl CaptureSource {
    /// An upload.
    pub fn upload(id: UploadId) -> Self {
        Self { upload: Some(id), ..Self::default() }
    }

    /// A file to fetch.
    pub fn url(url: impl Into<String>) -> Self {
        Self { url: Some(url.into()), ..Self::default() }
    }
}
