//! Image files: decodes PNG, JPEG, WebP, TIFF, EXR, HEIC and AVIF, encodes PNG and JPEG.
//!
//! The format is detected from the content, never from a file's name.

mod decode;
mod encode;
mod header;
mod heif_jpeg;
mod jpeg_end;
#[cfg(test)]
mod tests;

pub use decode::{Photograph, decode, decode_photograph, decode_reduced};
pub use encode::{encode_jpeg, encode_png, encode_png16, encode_rgba};
pub(crate) use header::is_grey;
pub use header::{bit_depth, dimensions};
pub(crate) use heif_jpeg::heif_as_jpeg;

/// Default limit on the pixels of one image.
pub const DEFAULT_MAX_PIXELS: u64 = 134_000_000;
