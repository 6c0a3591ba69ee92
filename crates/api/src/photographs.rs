//! The photographs of a capture.

use serde::{Deserialize, Serialize};

use crate::cameras::{CameraConvention, CapturedCamera};

/// The photographs of a capture with their cameras.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CapturePhotographs {
    /// Convention of the camera poses.
    pub convention: CameraConvention,
    /// Photographs in the order of the capture.
    pub photographs: Vec<CapturedPhotograph>,
}

/// A photograph of a capture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CapturedPhotograph {
    /// Name, size and camera.
    #[serde(flatten)]
    pub taken: CapturedCamera,
    /// Warnings of the validation about the photograph.
    pub warnings: Vec<String>,
    /// Path of the image on this server.
    pub href: String,
}
