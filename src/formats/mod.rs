//! Bytes to plain data and back.

pub mod model_file;
