//! Masks: image files that mark the object in photographs. Programs name them in many ways, so this module finds them by their
//! names, reads their values, and checks what they leave of the photographs.

mod coverage;
mod names;
mod pixels;

pub(super) use coverage::check;
pub(super) use names::{MaskFile, assign, find, separate};
pub(super) use pixels::{apply, as_png};

/// A path without its file extension.
pub(super) fn stem(path: &str) -> &str {
    match path.rsplit_once('.') {
        Some((stem, ending)) if !ending.contains('/') => stem,
        _ => path,
    }
}
