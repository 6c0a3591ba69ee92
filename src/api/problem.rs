//! RFC 9457 problem details: the one shape of every error.

use serde::{Deserialize, Serialize};

use crate::api::ResourceName;

/// Prefix of every problem type; what follows is stable.
pub const TYPE_PREFIX: &str = "urn:relume:problem:";

/// The body of every error, `application/problem+json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct Problem {
    /// Stable URI of the kind of problem, e.g. `urn:relume:problem:invalid-field`.
    #[serde(rename = "type")]
    pub kind: String,
    /// A short description of the kind.
    pub title: String,
    /// HTTP status.
    pub status: u16,
    /// What happened in this request.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub detail: Option<String>,
    /// Identifier of the request, also in the `x-request-id` header and in the server's log.
    pub request_id: String,
    /// Fields at fault.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub errors: Vec<FieldError>,
    /// What an importer found wrong with an uploaded file.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub content: Option<ContentError>,
    /// What needs the thing that was to be deleted, at most 100 names.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub needed_by: Vec<ResourceName>,
    /// Seconds after which to try again. The server sends it as the header `Retry-After`, not in the body.
    #[serde(skip)]
    pub retry_after: Option<u32>,
}

/// A field of the request that is at fault.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct FieldError {
    /// JSON pointer into the body, or `query/<name>`, `header/<name>`.
    pub pointer: String,
    /// What is wrong with it.
    pub detail: String,
}

/// What is wrong inside an uploaded file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct ContentError {
    /// Stable code, e.g. `capture_archive_damaged`.
    pub code: String,
    /// The file at fault, relative to the archive.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub file: Option<String>,
    /// The field of that file.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub field: Option<String>,
}
