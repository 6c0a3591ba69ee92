//! Signed URLs, for clients that cannot send a key, such as `<img>` and `EventSource`.

use serde::{Deserialize, Serialize};

/// A URL to sign.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewSignedUrl {
    /// Path and query of a thumbnail, of a model's stream, light or file, of an export's file, of a job's
    /// events, or of the page of a model, at most 2048 characters, e.g. `/v1/models/ID/thumbnail?size=256` or
    /// `/share/ID?light=sunset`.
    #[schema(min_length = 1, max_length = 2048)]
    pub path: String,
    /// Life of the URL, seconds, 1 to 604,800 (one week). Omitted: 3600.
    #[serde(default = "an_hour")]
    #[schema(minimum = 1, maximum = 604_800, default = 3600)]
    pub expires_in: u64,
}

impl NewSignedUrl {
    /// Longest life of a signed URL, seconds.
    pub const MAX_LIFETIME_S: u64 = 7 * 24 * 3600;
}

fn an_hour() -> u64 {
    3600
}

/// A URL that is valid without a key.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct SignedUrl {
    /// URL relative to the server's address. Any change of its parameters or of their order invalidates it.
    pub url: String,
    /// Expiry time, RFC 3339.
    pub expires_at: String,
}
