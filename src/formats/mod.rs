//! Bytes to plain data and back.

pub mod environment;
mod error;
pub mod exr_frame;
pub mod exr_image;
pub mod image_file;
pub mod model_file;
pub mod ply_model;
pub mod ply_points;
pub mod srgb;

pub use error::ImageFileError;
