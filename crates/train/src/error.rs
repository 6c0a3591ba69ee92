//! Errors of training.

use relume_capture::CaptureError;
use relume_engine::DeviceError;

/// Consecutive roll-backs after which the optimisation fails.
pub(super) const MAX_ROLLBACKS: u32 = 6;

/// Reasons why a training cannot start or continue.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// A setting or the capture is unsuitable for training; the message names it.
    #[error("{0}")]
    Invalid(String),
    /// The capture could not be imported.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// The training would need more memory than is available; the message names the setting at fault and a value that
    /// would fit.
    #[error("{0}")]
    Memory(String),
    /// A checkpoint could not be read; the message names the field.
    #[error("checkpoint: {0}")]
    Checkpoint(String),
    /// Loss or gradients stayed non-finite after every roll-back.
    #[error("optimisation diverged at step {step}: still not finite after {MAX_ROLLBACKS} roll-backs")]
    Diverged {
        /// The step at which the optimisation failed.
        step: u32,
    },
    /// The device failed. The training can resume from its last checkpoint, on this device or another.
    #[error(transparent)]
    Device(#[from] DeviceError),
}
