//! Why a training ends without a model.

use relume_capture::CaptureError;
use relume_engine::DeviceError;

/// Roll-backs in a row after which the optimisation is given up.
pub(super) const MAX_ROLLBACKS: u32 = 6;

/// Why a training cannot start or go on.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// A setting or the capture cannot be trained on; the message names what.
    #[error("{0}")]
    Invalid(String),
    /// The capture could not be imported.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// The training would need more memory than there is; the message names the setting at fault and what would fit.
    #[error("{0}")]
    Memory(String),
    /// A checkpoint could not be read; the message names the field.
    #[error("checkpoint: {0}")]
    Checkpoint(String),
    /// Loss or gradients stayed non-finite through every roll-back.
    #[error("optimisation diverged at step {step}: still not finite after {MAX_ROLLBACKS} roll-backs")]
    Diverged {
        /// The step that could not be passed.
        step: u32,
    },
    /// The device failed; the training can go on from its last checkpoint, here or elsewhere.
    #[error(transparent)]
    Device(#[from] DeviceError),
}
