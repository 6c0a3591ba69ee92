//! Storage use.

use serde::{Deserialize, Serialize};

/// Storage use and limits of a tenant.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Usage {
    /// Captures.
    pub captures: StoredKind,
    /// Uploaded environment maps.
    pub environments: StoredKind,
    /// Models with all their files.
    pub models: StoredKind,
    /// Resumable uploads with their stored bytes.
    #[serde(default)]
    pub uploads: StoredKind,
    /// Exports with their files, and with the completed frames of queued and running exports.
    #[serde(default)]
    pub exports: StoredKind,
    /// Checkpoints of queued and running jobs.
    pub checkpoints: StoredKind,
    /// Size of files that belong to none of these, bytes: uploads in progress, deleted files that are still
    /// in use, and quarantined files. 0 unless the caller is an administrator of the tenant `default`.
    pub unreferenced_bytes: u64,
    /// Storage limit of the tenant, bytes. If the tenant has no limit: for administrators of the tenant
    /// `default`, the limit of all tenants together. Absent without a limit.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub limit_bytes: Option<u64>,
    /// Free disk space, bytes. Only for administrators of the tenant `default`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub free_bytes: Option<u64>,
}

/// Storage use of one kind of resource.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct StoredKind {
    /// Number of resources.
    pub count: u64,
    /// Size of their files, bytes.
    pub bytes: u64,
}
