//! Posed photographs: archives and importers, and the synthetic scene.

mod archive;
mod blender;
mod bounds;
mod cameras;
mod colmap;
mod error;
mod grey_card;
mod images;
mod import;
mod json;
mod lens;
mod light_rotations;
mod lights;
mod nerfstudio;
mod options;
mod photos;
mod source;
mod synthetic;
mod transforms;
mod truth;
mod types;
mod undistort;
mod write_archive;

pub(crate) use bounds::{framing, looked_at};
pub use cameras::{PhotoCamera, cameras};
pub use error::CaptureError;
pub use grey_card::GreyCard;
pub use import::{CaptureReport, import, inspect};
pub use lens::{Distortion, Intrinsics, Lens};
pub use lights::{BUILTIN, builtin};
pub use options::{ImportLimits, ImportOptions};
pub use source::Source;
pub use synthetic::{SyntheticOptions, SyntheticScene, synthetic};
pub use types::{Capture, CaptureView, GroundTruthView, Scene3dBounds};
pub use write_archive::write_archive;
