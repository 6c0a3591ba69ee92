//! Why a configuration is refused.

/// A setting that no training can run with.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {reason}")]
pub struct ConfigError {
    /// Path of the setting within the overrides, e.g. `rates.mean`.
    pub field: String,
    /// What is wrong with it, and what is accepted.
    pub reason: String,
}

impl ConfigError {
    pub(in crate::train) fn new(field: impl Into<String>, reason: impl Into<String>) -> Self {
        Self { field: field.into(), reason: reason.into() }
    }
}
