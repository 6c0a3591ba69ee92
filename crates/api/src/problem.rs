//! RFC 9457 problem details, the body of every error.

use serde::{Deserialize, Serialize};

use crate::ResourceName;

/// Prefix of every problem type. The part after the prefix is stable.
pub const TYPE_PREFIX: &str = "urn:relume:problem:";

/// Problem details (RFC 9457), the body of every error, `application/problem+json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Problem {
    /// Stable URI of the problem type, e.g. `urn:relume:problem:invalid-field`.
    #[serde(rename = "type")]
    pub kind: String,
    /// Short description of the problem type.
    pub title: String,
    /// HTTP status code.
    pub status: u16,
    /// Description of this occurrence.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub detail: Option<String>,
    /// Identifier of the request, as in the `x-request-id` header and in the server's log.
    pub request_id: String,
    /// Invalid fields.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub errors: Vec<FieldError>,
    /// Error inside an uploaded file.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub content: Option<ContentError>,
    /// Resources that need the resource to be deleted, at most 100.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub needed_by: Vec<ResourceName>,
    /// Delay before a retry, seconds. The server sends it as the header `Retry-After`, not in the body.
    #[serde(skip)]
    pub retry_after: Option<u32>,
}

/// An invalid field of the request.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct FieldError {
    /// JSON pointer into the body, or `query/<name>` or `header/<name>`.
    pub pointer: String,
    /// Reason.
    pub detail: String,
}

/// An error inside an uploaded file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ContentError {
    /// Stable code, e.g. `capture_archive_damaged`.
    pub code: String,
    /// Path of the invalid file in the archive.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub file: Option<String>,
    /// Invalid field of that file.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub field: Option<String>,
}
