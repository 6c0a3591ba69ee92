//! Errors of a device.

/// Error of a device; each variant is one that callers handle differently.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DeviceError {
    /// The adapter does not exist, or it lacks a feature that the engine needs.
    #[error("{0}")]
    Unavailable(String),
    /// One buffer would be larger than the device can bind.
    #[error("{what} needs {needs} bytes on the device, which binds at most {most}")]
    TooLarge {
        /// Purpose of the memory.
        what: String,
        /// Bytes needed.
        needs: u64,
        /// Bytes available.
        most: u64,
    },
    /// The device has no memory left.
    #[error("the device ran out of memory at {what} ({bytes} bytes)")]
    OutOfMemory {
        /// Purpose of the memory.
        what: String,
        /// Bytes requested.
        bytes: u64,
    },
    /// The device is lost; everything on it is unusable.
    #[error("the device was lost: {0}")]
    Lost(String),
    /// The device did not answer in time.
    #[error("the device did not answer within {0} s")]
    Timeout(u64),
    /// The caller passed inconsistent arguments; the text names them.
    #[error("the engine was used wrongly: {0}")]
    Misuse(String),
    /// The driver reported something unexpected, or a result is wrong; the text is for the log.
    #[error("internal device error: {0}")]
    Internal(String),
}
