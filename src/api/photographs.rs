//! The photographs of a capture.

use serde::{Deserialize, Serialize};

use crate::api::cameras::{CameraConvention, CapturedCamera};

/// The photographs of a capture, each with its camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct CapturePhotographs {
    /// How the poses of their cameras are written.
    pub convention: CameraConvention,
    /// In the order in which the capture names them.
    pub photographs: Vec<CapturedPhotograph>,
}

/// A photograph of a capture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct CapturedPhotograph {
    /// Its name, size and camera.
    #[serde(flatten)]
    pub taken: CapturedCamera,
    /// What the validation found in it.
    pub warnings: Vec<String>,
    /// Where its picture is: a path on this server.
    pub href: String,
}
