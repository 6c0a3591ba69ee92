//! The error of the image readers and writers.

/// Errors of reading and writing images.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ImageFileError {
    /// The file has no bytes.
    #[error("the file is empty")]
    Empty,
    /// Not a PNG, JPEG, WebP, TIFF or EXR file.
    #[error("not a PNG, JPEG, WebP, TIFF or EXR image (the first bytes are {0})")]
    UnknownKind(String),
    /// A file of another kind in the place of an image.
    #[error("{0}")]
    Foreign(&'static str),
    /// More pixels than allowed, according to the header.
    #[error("{width}x{height} pixels are more than the {limit} allowed")]
    TooManyPixels {
        /// Width according to the header.
        width: u64,
        /// Height according to the header.
        height: u64,
        /// Pixels allowed.
        limit: u64,
    },
    /// The file is truncated or corrupt.
    #[error("cannot be decoded: {0}")]
    Damaged(String),
    /// A valid file with content that the reader does not support; the text names it and the remedy.
    #[error("{0}")]
    Unsupported(String),
    /// The pixels given to an encoder do not match the size.
    #[error("{0}")]
    Encode(String),
}
