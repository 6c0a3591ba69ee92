//! File formats: conversion between bytes and plain data.

pub mod chromaticities;
mod colour;
pub mod environment;
mod error;
pub mod exif_data;
mod exr_channels;
pub mod exr_frame;
mod exr_header;
pub mod exr_image;
pub mod exr_matrix;
mod exr_window;
mod foreign;
pub mod gltf;
mod heif;
pub mod image_file;
pub mod model_file;
pub mod ply_model;
pub mod ply_points;
mod ply_table;
pub mod png_colour;
mod radiance;
mod raw_photo;
mod scene_light;
pub mod splat_import;
pub mod splats;
pub mod usd;
pub mod viewer_stream;

pub use colour::ColourConversion;
pub use error::ImageFileError;
pub use foreign::recognise as recognise_foreign;
pub(crate) use heif::is_heif;
pub use heif::{CONVERTER_PACKAGE, installed_converter};
pub use scene_light::SceneLight;
