//! The quota of a tenant.

/// The quota of each tenant; `None` is unlimited.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Quota {
    /// Queued and running jobs.
    pub jobs: Option<u32>,
    /// Bytes of captures, environments, models, exports and unfinished uploads. Content of several tenants counts for each of
    /// them.
    pub bytes: Option<u64>,
}
