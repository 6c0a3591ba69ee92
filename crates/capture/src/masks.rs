//! Mask files of single photographs that a layout does not name.

use crate::CaptureFiles;

/// The mask file of the photograph at `image`, if there is one: `masks/NAME.jpg.png`, `masks/NAME.png` (also
/// `mask/`), where `NAME` is its path below the folder of photographs, or `NAME_mask.png` in its own folder. White
/// marks the object.
pub(super) fn beside(source: &CaptureFiles, image: &str) -> Option<String> {
    let below = match image.split_once('/') {
        Some((folder, below)) if folder.starts_with("images") || folder == "input" => below,
        _ => image,
    };
    let (stem, own_stem) = (stem(below), stem(image));
    let named = ["masks", "mask"].into_iter();
    let named = named.flat_map(|folder| [format!("{folder}/{below}.png"), format!("{folder}/{stem}.png")]);
    let mut candidates = named.chain([format!("{own_stem}_mask.png")]);
    candidates.find(|mask| mask != image && source.contains(mask))
}

/// A path without its file extension.
pub(super) fn stem(path: &str) -> &str {
    match path.rsplit_once('.') {
        Some((stem, ending)) if !ending.contains('/') => stem,
        _ => path,
    }
}
