//! What a server has stored.

use serde::{Deserialize, Serialize};

/// What is stored of a tenant, and how much more may be.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct Usage {
    /// Captures.
    pub captures: StoredKind,
    /// Uploaded environment maps.
    pub environments: StoredKind,
    /// Models with all their files.
    pub models: StoredKind,
    /// Uploads that arrive in pieces, with what has arrived of them.
    #[serde(default)]
    pub uploads: StoredKind,
    /// Exports with their files, and with the frames that are there of those that wait or run.
    #[serde(default)]
    pub exports: StoredKind,
    /// Checkpoints of jobs that wait or run.
    pub checkpoints: StoredKind,
    /// Bytes of files that belong to none of these: uploads in progress, what was deleted and is still in use, what was set
    /// aside. 0 for everybody but the administrators of the tenant `default`.
    pub unreferenced_bytes: u64,
    /// Bytes that the tenant may store, or else, for administrators of the tenant `default`, the server together; absent when
    /// there is no such limit.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub limit_bytes: Option<u64>,
    /// Bytes that are free on the disk; for administrators of the tenant `default`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub free_bytes: Option<u64>,
}

/// How much there is of one kind.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct StoredKind {
    /// How many.
    pub count: u64,
    /// Bytes of their files.
    pub bytes: u64,
}
