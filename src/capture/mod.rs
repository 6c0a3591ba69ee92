//! Posed photographs: archives and importers, and the synthetic scene.

mod archive;
mod blender;
mod bounds;
mod error;
mod import;
mod lens;
mod options;
mod photos;
mod source;
mod transforms;
mod truth;
mod types;
mod undistort;

pub use error::CaptureError;
pub use import::{CaptureReport, import};
pub use lens::{Distortion, Intrinsics, Lens};
pub use options::{ImportOptions, Limits};
pub use source::Source;
pub use types::{Capture, CaptureView, GroundTruthView, ImageRgba, Plane, Scene3dBounds};
