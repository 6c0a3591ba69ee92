//! Signed URLs: for what cannot send a key, such as `<img>` and `EventSource`.

use serde::{Deserialize, Serialize};

/// A URL to be signed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct NewSignedUrl {
    /// Path and query of a thumbnail, of a model's stream, light or file, of an export's file, or of a job's events, e.g. `/v1/models/ID/thumbnail?size=256`.
    #[cfg_attr(feature = "server", schema(min_length = 1, max_length = 2048))]
    pub path: String,
    /// Seconds for which it is good, 1 to 604,800 (a week).
    #[serde(default = "an_hour")]
    #[cfg_attr(feature = "server", schema(minimum = 1, maximum = 604_800, default = 3600))]
    pub expires_in: u64,
}

impl NewSignedUrl {
    /// Longest life of a signed URL, seconds.
    pub const LONGEST_LIFE: u64 = 7 * 24 * 3600;
}

fn an_hour() -> u64 {
    3600
}

/// A URL that is good without a key.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct SignedUrl {
    /// Relative to the server's address. It is good as it stands: a parameter more or less, or another order, spoils it.
    pub url: String,
    /// RFC 3339.
    pub expires_at: String,
}
