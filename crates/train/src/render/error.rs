//! Errors of rendering.

use relume_engine::DeviceError;
use relume_scene::CameraError;

/// Errors of rendering.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RenderError {
    /// The request cannot be rendered.
    #[error("{field}: {reason}")]
    Refused {
        /// The request field at fault.
        field: &'static str,
        /// The reason.
        reason: String,
    },
    /// The caller no longer waits for the result.
    #[error("the caller no longer waits for the result")]
    Abandoned,
    /// The device failed.
    #[error(transparent)]
    Device(#[from] DeviceError),
}

impl From<CameraError> for RenderError {
    fn from(error: CameraError) -> Self {
        Self::Refused { field: error.field, reason: error.reason }
    }
}
