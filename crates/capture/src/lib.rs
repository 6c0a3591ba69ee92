//! Captures: import of posed photographs from folders and archives, camera poses from COLMAP, checks of photographs,
//! file formats, and the synthetic scene.

mod archive;
mod blender;
mod bounds;
mod cameras;
mod capture_files;
pub mod check;
mod colmap;
mod error;
pub mod formats;
mod grey_card;
mod images;
mod import;
mod json;
mod lens;
mod light_rotations;
mod lights;
mod llff;
mod masks;
mod nerfstudio;
mod options;
mod photographs;
mod photos;
mod photos_without_poses;
pub mod poses;
mod sharpness;
mod synthetic;
mod transforms;
mod truth;
mod types;
mod undistort;
mod upright;
mod write_archive;

pub use bounds::{focus_region, framing};
pub use cameras::{PhotoCamera, cameras, cameras_of_colmap, cameras_of_transforms};
pub use capture_files::CaptureFiles;
pub use error::CaptureError;
pub use import::{UndecodedCapture, import, inspect};
pub use lens::{Distortion, Intrinsics, Lens};
pub use lights::{BUILTIN, builtin};
pub use options::{ImportLimits, ImportOptions};
pub use photographs::{CapturePhotos, PictureOptions};
pub use photos_without_poses::PhotosWithoutPoses;
pub use synthetic::{SyntheticOptions, SyntheticScene, synthetic};
pub use types::{Capture, CaptureView, GroundTruthView, SceneBounds};
pub use write_archive::write_archive;
