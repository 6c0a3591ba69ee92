//! The record of a resumable upload, and the limits of uploads.

use std::time::Duration;

use sqlx::FromRow;

use crate::store::page::paginated;
use relume_api::metadata::ResourceMetadata;
use relume_api::{CaptureId, Problem, TenantId, UploadId};

/// The folder of resumable uploads.
pub(in crate::store) const UPLOADS: &str = "uploads";

/// The limits of resumable uploads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UploadLimits {
    /// Maximum number of unfinished uploads of a tenant.
    pub each: u32,
    /// Time for which an upload is kept after its last chunk.
    pub life: Duration,
}

impl Default for UploadLimits {
    fn default() -> Self {
        Self { each: 64, life: Duration::from_secs(24 * 3600) }
    }
}

/// A resumable upload.
#[derive(Debug, Clone, FromRow)]
pub struct UploadRecord {
    /// Identifier.
    pub id: UploadId,
    /// The tenant.
    pub tenant: TenantId,
    /// Total bytes.
    pub length: i64,
    /// Bytes on disk.
    pub received: i64,
    /// The header `Upload-Metadata`, as sent by the client.
    pub metadata: Option<String>,
    /// Time of creation.
    pub created_ms: i64,
    /// Expiry time.
    pub expires_ms: i64,
    /// The capture that is being made of it, or could not be made.
    pub capture_id: Option<CaptureId>,
    /// The metadata of that capture.
    #[sqlx(flatten)]
    pub capture_metadata: ResourceMetadata,
    /// Hash of its bytes, lower-case hex, since the validation of the capture began.
    pub sha256: Option<String>,
    /// The reason why no capture could be made.
    #[sqlx(json(nullable))]
    pub problem: Option<Problem>,
}

paginated!(UploadRecord: created_ms);

impl UploadRecord {
    /// Bytes on disk.
    pub fn offset(&self) -> u64 {
        u64::try_from(self.received).unwrap_or(0)
    }

    /// Total bytes.
    pub fn total(&self) -> u64 {
        u64::try_from(self.length).unwrap_or(0)
    }

    /// The artifact key of its bytes.
    pub(super) fn key(&self) -> String {
        key(&self.id)
    }
}

/// The artifact key of the bytes of an upload.
pub(super) fn key(id: &UploadId) -> String {
    format!("{UPLOADS}/{id}")
}
