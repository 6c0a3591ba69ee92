//! Finds the mask of each photograph by the names of files.
//!
//! | form | program |
//! |---|---|
//! | `masks/NAME.png`, `masks/NAME.jpg.png`, any image format, any folder of [`is_folder`] | COLMAP, museums' captures |
//! | `masks/NAME_mask.png` | Metashape |
//! | `NAME.mask.png`, `NAME.jpg.mask.png` beside the photograph | Brush, RealityScan |
//! | `NAME_mask.png` beside the photograph | nerfstudio |
//! | `dynamic_mask_NAME.png`, whose white pixels are hidden | Instant-NGP |
//!
//! Upper and lower case are equal. `NAME` may include folders.

use std::collections::{BTreeMap, BTreeSet};

use super::stem;
use crate::CaptureFiles;
use crate::error::name_list;
use crate::photos::PhotoEntry;
use crate::selection::PHOTOGRAPHS;

/// The mask of a photograph.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct MaskFile {
    /// Path in the capture.
    pub path: String,
    /// True: the white pixels of the mask are hidden. False: the white pixels show the object.
    pub hides: bool,
}

/// File extensions of masks that photographs do not have.
const MASK_ENDINGS: [&str; 2] = ["exr", "bmp"];
/// Ends of a mask's name before its extension.
const SUFFIXES: [&str; 6] = ["_mask", ".mask", "-mask", "_matte", "_segmentation", "_silhouette"];
/// Start of the name of a mask whose white pixels are hidden.
const HIDING: &str = "dynamic_mask_";
/// Folders of photographs, which the path of a mask may omit.
const PHOTO_FOLDERS: [&str; 6] = ["input", "photos", "photographs", "rgb", "color", "colour"];

/// What the name of a mask says.
struct MaskName {
    /// Path of its photograph with its extension, if the name contains it.
    exact: Option<String>,
    /// Path of its photograph without extension, folders of photographs and masks.
    key: String,
    hides: bool,
    in_folder: bool,
}

/// Whether a folder contains masks: `mask`, `masks_2`, `Masks`, `object_masks`, `segmentation`, `silhouettes`, `mattes`.
fn is_folder(name: &str) -> bool {
    let name = name.to_lowercase();
    let named = ["segmentation", "silhouette", "matte"].iter().any(|kind| name.starts_with(kind));
    named || name.starts_with("mask") || name.ends_with("_mask") || name.ends_with("_masks")
}

fn is_photo_folder(name: &str) -> bool {
    name.starts_with("images") || PHOTO_FOLDERS.contains(&name)
}

fn has_image_ending(name: &str) -> bool {
    name.rsplit_once('.')
        .is_some_and(|(_, ending)| PHOTOGRAPHS.contains(&ending) || MASK_ENDINGS.contains(&ending))
}

/// The folders of a path that tell photographs apart, and its file name, in lower case.
fn parts(path: &str) -> (Vec<String>, String) {
    let path = path.to_lowercase();
    let (folders, name) = path.rsplit_once('/').unwrap_or(("", &path));
    let kept = folders.split('/').filter(|f| !f.is_empty() && !is_photo_folder(f) && !is_folder(f));
    (kept.map(str::to_owned).collect(), name.to_owned())
}

fn joined(folders: &[String], name: &str) -> String {
    folders.iter().map(String::as_str).chain([name]).collect::<Vec<_>>().join("/")
}

/// Reads the name of a mask; `None` for other files.
fn read_name(path: &str) -> Option<MaskName> {
    let (folders, name) = parts(path);
    if !has_image_ending(&name) {
        return None;
    }
    let in_folder = path.split('/').rev().skip(1).any(is_folder);
    let (rest, hides) = match stem(&name).strip_prefix(HIDING) {
        Some(rest) => (rest, true),
        None => (stem(&name), false),
    };
    let suffix = SUFFIXES.iter().find_map(|suffix| rest.strip_suffix(suffix));
    if !in_folder && !hides && suffix.is_none() {
        return None;
    }
    let rest = suffix.unwrap_or(rest);
    let exact = has_image_ending(rest).then(|| joined(&folders, rest));
    let key = joined(&folders, if exact.is_some() { stem(rest) } else { rest });
    Some(MaskName { exact, key, hides, in_folder })
}

/// Whether a path is that of a mask, judged by its name alone.
fn is_mask(path: &str) -> bool {
    read_name(path).is_some()
}

/// The photographs among image files. A file in a folder of masks is a mask; a file that is a mask by its ending is one if
/// its photograph is there.
pub(crate) fn separate<'a>(images: impl IntoIterator<Item = &'a str>) -> BTreeSet<&'a str> {
    let (named, mut photos): (Vec<&str>, BTreeSet<&str>) = {
        let (named, others): (Vec<_>, Vec<_>) = images.into_iter().partition(|path| is_mask(path));
        (named, others.into_iter().collect())
    };
    let photo_keys: BTreeSet<String> = photos.iter().map(|photo| key_of(photo)).collect();
    photos.extend(named.into_iter().filter(|path| {
        read_name(path).is_some_and(|mask| !mask.in_folder && !photo_keys.contains(&mask.key))
    }));
    photos
}

fn key_of(photo: &str) -> String {
    let (folders, name) = parts(photo);
    joined(&folders, stem(&name))
}

/// The masks of photographs, by the photographs' order.
pub(crate) struct Assigned {
    /// The mask of each photograph.
    pub masks: Vec<Option<MaskFile>>,
    /// Masks that are not used, each with the reason.
    pub unused: Vec<String>,
}

/// Finds the masks of `photos` among `files`.
pub(crate) fn assign<'a>(photos: &[&str], files: impl IntoIterator<Item = &'a str>) -> Assigned {
    let taken: BTreeSet<&str> = photos.iter().copied().collect();
    let by_exact: BTreeMap<String, usize> = photos
        .iter()
        .enumerate()
        .map(|(i, photo)| {
            let (folders, name) = parts(photo);
            (joined(&folders, &name), i)
        })
        .collect();
    let by_key = unique(photos.iter().map(|photo| key_of(photo)));
    let by_name = unique(photos.iter().map(|photo| stem(&parts(photo).1).to_owned()));
    let (mut masks, mut unused) = (vec![None; photos.len()], Vec::new());
    for path in files.into_iter().filter(|path| !taken.contains(path)) {
        let Some(name) = read_name(path) else { continue };
        let own_name = name.key.rsplit('/').next().unwrap_or_default();
        let exact = name.exact.as_ref().and_then(|exact| by_exact.get(exact).copied().map(Some));
        let found =
            exact.or_else(|| by_key.get(&name.key).copied()).or_else(|| by_name.get(own_name).copied());
        match found {
            Some(Some(i)) if masks[i].is_none() => {
                masks[i] = Some(MaskFile { path: path.to_owned(), hides: name.hides });
            }
            Some(Some(i)) => unused.push(format!("{path} ({} has another mask)", photos[i])),
            Some(None) => unused.push(format!("{path} (several photographs have this name)")),
            None => unused.push(format!("{path} (no photograph has this name)")),
        }
    }
    Assigned { masks, unused }
}

/// The index of each value; `None` for a value that occurs more than once.
fn unique(values: impl Iterator<Item = String>) -> BTreeMap<String, Option<usize>> {
    let mut found = BTreeMap::new();
    for (i, value) in values.enumerate() {
        found.entry(value).and_modify(|other| *other = None).or_insert(Some(i));
    }
    found
}

/// Gives each photograph without a mask the mask file that its name points to. Warns of masks that are not used, and of
/// photographs without a mask where others have one.
pub(crate) fn find(source: &CaptureFiles, photos: &mut [PhotoEntry], warnings: &mut Vec<String>) {
    let named: BTreeSet<String> = photos.iter().filter_map(|p| Some(p.mask.as_ref()?.path.clone())).collect();
    let names: Vec<&str> = photos.iter().map(|photo| photo.image.as_str()).collect();
    let files = source.paths().filter(|path| !named.contains(*path));
    let Assigned { masks, unused } = assign(&names, files);
    for (photo, mask) in photos.iter_mut().zip(masks) {
        photo.mask = photo.mask.take().or(mask);
    }
    let without: Vec<String> =
        photos.iter().filter(|photo| photo.mask.is_none()).map(|photo| photo.image.clone()).collect();
    let used = photos.len() - without.len();
    if !unused.is_empty() {
        let all = used + unused.len();
        warnings.push(format!("masks: {all}, used: {used}; not used: {}", name_list(&unused)));
    }
    if used > 0 && !without.is_empty() {
        warnings.push(format!(
            "photographs without a mask: {} of {}; all of their pixels count as the object: {}",
            without.len(),
            photos.len(),
            name_list(&without)
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The masks that `files` give the photographs `a` and `b/c`, and the number of unused masks.
    fn masks_of(files: &[&str]) -> (Vec<Option<String>>, usize) {
        let assigned = assign(&["images/a.jpg", "images/b/c.JPG"], files.iter().copied());
        (assigned.masks.into_iter().map(|mask| mask.map(|m| m.path)).collect(), assigned.unused.len())
    }

    #[test]
    fn masks_have_every_ending_of_photographs_and_two_more() {
        for ending in PHOTOGRAPHS.into_iter().chain(["exr", "bmp"]) {
            let mask = format!("masks/a.{ending}");
            assert_eq!(masks_of(&[&mask]), (vec![Some(mask.clone()), None], 0));
        }
        assert_eq!(masks_of(&["masks/a.txt"]), (vec![None, None], 0), "the control");
    }

    #[test]
    fn every_common_form_of_mask_names_is_found() {
        for (first, second) in [
            ("masks/a.png", "masks/b/c.png"),
            ("masks/a.jpg", "masks/b/c.jpg"),
            ("masks/a.jpg.png", "masks/b/c.JPG.png"),
            ("Masks/A.PNG", "Masks/B/C.PNG"),
            ("mask/a.png", "mask/c.png"),
            ("masks_2/a.png", "masks_2/b/c.png"),
            ("segmentation/a.png", "segmentation/b/c.png"),
            ("masks/a_mask.png", "masks/b/c_mask.png"),
            ("images/a_mask.png", "images/b/c_mask.png"),
            ("images/a.mask.png", "images/b/c.mask.png"),
            ("images/a.jpg.mask.png", "images/b/c.JPG.mask.png"),
        ] {
            assert_eq!(
                masks_of(&[first, second]),
                (vec![Some(first.to_owned()), Some(second.to_owned())], 0)
            );
        }
        assert_eq!(masks_of(&["b/masks/c.tif"]), (vec![None, Some("b/masks/c.tif".to_owned())], 0));
        assert_eq!(masks_of(&["notes/a.png"]), (vec![None; 2], 0), "the control: no masks");
    }

    #[test]
    fn masks_that_hide_are_told_from_masks_of_the_object() {
        let hides = |file: &str| assign(&["images/a.jpg"], [file]).masks[0].clone().map(|mask| mask.hides);
        assert_eq!(hides("images/dynamic_mask_a.png"), Some(true));
        assert_eq!(hides("masks/a.png"), Some(false));
        assert_eq!(hides("images/b.png"), None, "the control: no mask");
    }

    #[test]
    fn unused_masks_are_listed_with_the_reason() {
        let assigned = assign(
            &["images/a.jpg", "images/x/b.jpg", "images/y/b.jpg"],
            ["masks/a.png", "masks/a.jpg.png", "masks/b.png", "masks/other.png", "notes/b.png"],
        );
        assert_eq!(
            assigned.unused,
            [
                "masks/a.jpg.png (images/a.jpg has another mask)",
                "masks/b.png (several photographs have this name)",
                "masks/other.png (no photograph has this name)",
            ]
        );
    }

    #[test]
    fn equal_names_with_other_extensions_have_their_own_masks() {
        let photos = ["images/a.jpg", "images/a.png"];
        let assigned = assign(&photos, ["masks/a.jpg.png", "masks/a.png.png"]);
        let paths: Vec<_> = assigned.masks.into_iter().map(|mask| mask.unwrap().path).collect();
        assert_eq!(paths, ["masks/a.jpg.png", "masks/a.png.png"]);
    }

    #[test]
    fn files_are_separated_into_photographs_and_masks() {
        let files = ["images/a.JPG", "images/a.mask.png", "images/b_mask.png", "masks/c.png", "Masks/a.png"];
        assert_eq!(separate(files).into_iter().collect::<Vec<_>>(), ["images/a.JPG", "images/b_mask.png"]);
    }
}
