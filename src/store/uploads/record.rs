//! An upload that arrives in pieces, and the bounds on all of them.

use std::time::Duration;

use sqlx::FromRow;

use crate::store::page::paginated;
use relume_api::metadata::ResourceMetadata;
use relume_api::{CaptureId, Problem, TenantId, UploadId};

/// The folder of uploads that arrive in pieces.
pub(in crate::store) const UPLOADS: &str = "uploads";

/// How many uploads there may be, and how long.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UploadLimits {
    /// Uploads of a tenant that no capture was made of.
    pub each: u32,
    /// How long one is kept after its last piece.
    pub life: Duration,
}

impl Default for UploadLimits {
    fn default() -> Self {
        Self { each: 64, life: Duration::from_secs(24 * 3600) }
    }
}

/// An upload that arrives in pieces.
#[derive(Debug, Clone, FromRow)]
pub struct UploadRecord {
    /// Identifier.
    pub id: UploadId,
    /// Whose it is.
    pub tenant: TenantId,
    /// Bytes when it is complete.
    pub length: i64,
    /// Bytes that are on disk.
    pub received: i64,
    /// What the uploader says of it, as it was sent.
    pub metadata: Option<String>,
    /// When it was begun.
    pub created_ms: i64,
    /// When it is given up.
    pub expires_ms: i64,
    /// The capture that is being made of it, or could not be made.
    pub capture_id: Option<CaptureId>,
    /// What that capture is called.
    #[sqlx(flatten)]
    pub capture_metadata: ResourceMetadata,
    /// Hash of its bytes, lower-case hex, once a capture is being made of it.
    pub sha256: Option<String>,
    /// Why no capture could be made of it.
    #[sqlx(json(nullable))]
    pub problem: Option<Problem>,
}

paginated!(UploadRecord: created_ms);

impl UploadRecord {
    /// Bytes that are on disk.
    pub fn offset(&self) -> u64 {
        u64::try_from(self.received).unwrap_or(0)
    }

    /// Bytes when it is complete.
    pub fn total(&self) -> u64 {
        u64::try_from(self.length).unwrap_or(0)
    }

    /// The key of its bytes.
    pub(super) fn key(&self) -> String {
        key(&self.id)
    }
}

/// The key of the bytes of an upload.
pub(super) fn key(id: &UploadId) -> String {
    format!("{UPLOADS}/{id}")
}
