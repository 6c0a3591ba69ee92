//! The error of the image readers and writers.

/// Errors of reading and writing images.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ImageFileError {
    /// The file has no bytes.
    #[error("the file is empty")]
    Empty,
    /// Not an image of a supported kind.
    #[error("not a PNG, JPEG, WebP, TIFF, EXR, HEIC or AVIF image (the first bytes are {0})")]
    UnknownKind(String),
    /// A file of another kind in the place of an image.
    #[error("{0}")]
    Foreign(&'static str),
    /// A raw file of a camera. Such files contain a thumbnail, which is not the photograph.
    #[error("is a camera raw file ({0}); develop it to JPEG, PNG or 16-bit TIFF first")]
    CameraRaw(&'static str),
    /// A HEIC or AVIF picture on a machine without a converter.
    #[error(
        "is a {kind} picture, and no converter is installed (heif-convert or heif-dec on PATH): {install}; or convert the picture \
         to JPEG"
    )]
    NoConverter {
        /// HEIC or AVIF.
        kind: &'static str,
        /// How to install a converter.
        install: &'static str,
    },
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
