//! How much one tenant may have.

/// How much each tenant may have; what has no number is not bounded.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Quota {
    /// Jobs that wait or run.
    pub jobs: Option<u32>,
    /// Bytes of captures, environments, models, exports and unfinished uploads. What several tenants have counts for each.
    pub bytes: Option<u64>,
}
