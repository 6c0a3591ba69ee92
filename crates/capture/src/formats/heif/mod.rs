//! HEIC and AVIF pictures: the header is read here, the pixels by an installed converter.

mod boxes;
mod convert;

pub(super) use boxes::header;
pub(crate) use boxes::is_heif;
pub use convert::{CONVERTER_PACKAGE, installed_converter};
pub(super) use convert::{to_jpeg, to_png};
