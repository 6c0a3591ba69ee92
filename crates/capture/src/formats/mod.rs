//! File formats: conversion between bytes and plain data.

pub mod chromaticities;
pub mod environment;
mod error;
pub mod exif_data;
mod exr_channels;
pub mod exr_frame;
mod exr_header;
pub mod exr_image;
mod exr_window;
mod foreign;
pub mod gltf;
pub mod image_file;
pub mod model_file;
pub mod ply_model;
pub mod ply_points;
mod ply_table;
mod radiance;
pub mod splat_import;
pub mod splats;
pub mod usd;
pub mod viewer_stream;

pub use error::ImageFileError;
pub use foreign::recognise as recognise_foreign;
