//! Posed photographs: archives and importers, and the synthetic scene.

mod types;

pub use types::{Capture, CaptureView, GroundTruthView, ImageRgba, Plane, Scene3dBounds};
