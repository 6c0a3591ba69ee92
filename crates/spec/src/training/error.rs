//! Errors of training configurations.

/// An invalid setting of a training.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {reason}")]
pub struct ConfigError {
    /// Path of the setting within the overrides, e.g. `rates.mean`.
    pub field: String,
    /// The reason, and the accepted values.
    pub reason: String,
}

impl ConfigError {
    pub(crate) fn new(field: impl Into<String>, reason: impl Into<String>) -> Self {
        Self { field: field.into(), reason: reason.into() }
    }
}
