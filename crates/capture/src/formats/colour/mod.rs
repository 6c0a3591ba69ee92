//! The colour spaces of photographs, and their conversion to sRGB.

mod convert;
mod png_chunks;
mod profile;
mod stated;
#[cfg(test)]
mod tests;

pub use convert::ColourConversion;
pub(super) use convert::convert;
pub(super) use stated::StatedColour;
