//! The error of the image readers and writers.

/// Why an image was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ImageFileError {
    /// The file has no bytes.
    #[error("the file is empty")]
    Empty,
    /// Not a PNG, JPEG, WebP, TIFF or EXR file.
    #[error("not a PNG, JPEG, WebP, TIFF or EXR image (it begins with {0})")]
    UnknownKind(String),
    /// More pixels than allowed, according to the header.
    #[error("{width}x{height} pixels are more than the {limit} allowed")]
    TooManyPixels {
        /// Width the header names.
        width: u64,
        /// Height the header names.
        height: u64,
        /// Pixels allowed.
        limit: u64,
    },
    /// Cut short or corrupt.
    #[error("cannot be decoded: {0}")]
    Damaged(String),
    /// The pixels handed to an encoder do not fit the size.
    #[error("{0}")]
    Encode(String),
}
