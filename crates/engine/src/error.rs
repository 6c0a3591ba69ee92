//! What can go wrong on a device.

/// Why a device did not do what was asked, as far as a caller can act on it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DeviceError {
    /// There is no such adapter, or it lacks what the engine needs.
    #[error("{0}")]
    Unavailable(String),
    /// One buffer would be larger than the device binds.
    #[error("{what} needs {needs} bytes on the device, which binds at most {most}")]
    TooLarge {
        /// What the memory is for.
        what: String,
        /// Bytes needed.
        needs: u64,
        /// Bytes that can be had.
        most: u64,
    },
    /// The device has no memory left.
    #[error("the device ran out of memory at {what} ({bytes} bytes)")]
    OutOfMemory {
        /// What the memory was for.
        what: String,
        /// Bytes asked for.
        bytes: u64,
    },
    /// The device went away; nothing on it can be used any more.
    #[error("the device was lost: {0}")]
    Lost(String),
    /// The device did not answer in time.
    #[error("the device did not answer within {0} s")]
    Timeout(u64),
    /// The caller passed what does not fit together; the text says what.
    #[error("the engine was used wrongly: {0}")]
    Misuse(String),
    /// The driver reported something unexpected, or a result is wrong; the text is for the log.
    #[error("internal device error: {0}")]
    Internal(String),
}
