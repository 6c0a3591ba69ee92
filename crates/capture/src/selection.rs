//! Tells photographs from other image files where no layout lists them: masks, depth maps, reduced copies, raw files and plots.

use std::collections::{BTreeMap, BTreeSet};

use crate::formats::{exif_data, image_file};
use crate::masks::{self, stem};
use crate::{CaptureError, CaptureFiles, images};

/// File extensions of photographs.
pub(super) const PHOTOGRAPHS: [&str; 10] =
    ["jpg", "jpeg", "png", "tif", "tiff", "webp", "heic", "heif", "hif", "avif"];
/// File extensions of phone pictures, which need an installed converter.
const PHONE_PICTURES: [&str; 4] = ["heic", "heif", "hif", "avif"];
/// File extensions of copies of phone pictures.
const PHONE_COPIES: [&str; 5] = ["jpg", "jpeg", "png", "tif", "tiff"];
/// File extensions of camera raw files.
const RAWS: [&str; 16] = [
    "dng", "cr2", "cr3", "crw", "nef", "nrw", "arw", "sr2", "raf", "orf", "rw2", "pef", "srw", "x3f", "3fr",
    "iiq",
];
/// File extensions of other images, which Relume does not read.
const UNREAD: [&str; 9] = ["gif", "bmp", "jp2", "j2k", "jxl", "psd", "svg", "ppm", "tga"];
/// Folders of photographs, beside which programs write reduced copies in a folder like `images_4`.
const PHOTO_FOLDERS: [&str; 5] = ["images", "image", "input", "rgb", "photos"];
/// Folders of maps.
const MAP_FOLDERS: [&str; 9] = [
    "depth",
    "depths",
    "depth_maps",
    "depthmaps",
    "depth_images",
    "confidence",
    "confidences",
    "confidence_maps",
    "conf",
];
/// Ends of the names of maps, before the file extension.
const MAP_SUFFIXES: [&str; 6] = [".depth", "_depth", "-depth", ".confidence", "_confidence", ".conf"];
/// Folders of the results of programs.
const RESULT_FOLDERS: [&str; 16] = [
    "results",
    "result",
    "output",
    "outputs",
    "plots",
    "plot",
    "figures",
    "figs",
    "docs",
    "doc",
    "thumbnails",
    "thumbs",
    "previews",
    "preview",
    "screenshots",
    "logs",
];
/// Names of pictures that show the photographs or the result in small.
const SMALL_PICTURES: [&str; 6] = ["thumbnail", "thumb", "preview", "cover", "icon", "logo"];
/// Least share of the photographs in the main folder for which pictures elsewhere are examined.
const MAIN_SHARE: f64 = 0.8;
/// Number of photographs of the main folder whose headers are read for comparison.
const SAMPLES: usize = 16;

/// Names of files with camera poses by Metashape, RealityScan, Bundler, OpenSfM and Meshroom, which Relume does not read.
const POSE_FILES: [&str; 5] =
    ["cameras.xml", "cameras.csv", "bundle.out", "reconstruction.json", "cameras.sfm"];

const HAS_POSES: &str = "has camera poses in a form that Relume does not read; export a COLMAP model or a transforms.json to use them";
const IS_RAW_COPY: &str = "is a camera raw file beside a photograph of the same name";
const IS_RAW: &str = "is a camera raw file; develop it to JPEG, PNG or 16-bit TIFF to use it";
const IS_UNREAD: &str =
    "is an image of a kind that Relume does not read; convert it to PNG or JPEG to use it";
const IS_MAP: &str = "is a depth or confidence map";
const IS_PHONE_COPY: &str = "is a HEIC or AVIF picture beside a JPEG, PNG or TIFF of the same name";
const IS_REDUCED: &str = "is a reduced copy of a photograph";
const IS_UNCORRECTED: &str = "is the uncorrected copy of a photograph in corrected_images";
const IS_RESULT: &str = "is in a folder of results, plots or documents";
const IS_SMALL_PICTURE: &str = "is a preview outside the folder of the photographs, by its name";
const IS_GREY: &str = "is a grey picture outside the folder of the photographs, which have colours";
const HAS_OTHER_SIZE: &str = "is a picture of another size outside the folder of the photographs";

/// A file that is not used: an image that is no photograph, or camera poses of another program.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct IgnoredFile {
    /// Path in the folder or archive.
    pub path: String,
    /// The reason, a sentence without its subject: "is a depth or confidence map".
    pub reason: &'static str,
}

/// The photographs, sorted, and the image files that are none.
#[derive(Debug, Default)]
pub(super) struct Selection {
    pub photos: Vec<String>,
    pub ignored: Vec<IgnoredFile>,
}

/// # Errors
/// [`CaptureError::File`] with the remedy if there are raw files of a camera. For files without a photograph.
pub(super) fn refuse_raw_files(source: &CaptureFiles) -> Result<(), CaptureError> {
    let raws = source.paths().filter(|path| is_raw(path)).count();
    if raws == 0 {
        return Ok(());
    }
    let reason = format!(
        "contains no photographs but raw files of a camera: {raws}; develop them to JPEG, PNG or 16-bit TIFF first"
    );
    Err(CaptureError::File { file: source.label().to_owned(), reason })
}

/// Selects the photographs among all files.
///
/// # Errors
/// [`CaptureError::Io`] when a header cannot be read.
pub(super) fn select(source: &CaptureFiles) -> Result<Selection, CaptureError> {
    let photos = masks::separate(source.paths().filter(|path| has_ending(path, &PHOTOGRAPHS)));
    let mut candidates: BTreeSet<&str> = photos;
    let mut ignored = Vec::new();
    let mut drop = |candidates: &mut BTreeSet<&str>, found: Vec<(&str, &'static str)>| {
        // Files that are all that there is are photographs.
        if found.len() < candidates.len() {
            for (path, reason) in found {
                candidates.remove(path);
                ignored.push(IgnoredFile { path: path.to_owned(), reason });
            }
        }
    };
    for reason_of in [map_reason, phone_reason, copy_reason] {
        let keys = keys_of(&candidates);
        let mut found = Vec::new();
        for path in &candidates {
            found.extend(reason_of(source, path, &keys)?.map(|reason| (*path, reason)));
        }
        drop(&mut candidates, found);
    }
    let found = others(source, &candidates)?;
    drop(&mut candidates, found);
    let keys = keys_of(&candidates);
    for path in source.paths() {
        let reason = match path {
            _ if is_raw(path) && keys.contains_key(&key(path)) => IS_RAW_COPY,
            _ if is_raw(path) => IS_RAW,
            _ if has_ending(path, &UNREAD) => IS_UNREAD,
            _ if POSE_FILES.contains(&file_name(path).as_str()) => HAS_POSES,
            _ => continue,
        };
        ignored.push(IgnoredFile { path: path.to_owned(), reason });
    }
    ignored.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(Selection { photos: candidates.into_iter().map(str::to_owned).collect(), ignored })
}

/// Whether a file is a camera raw file by its name.
pub(super) fn is_raw(path: &str) -> bool {
    has_ending(path, &RAWS)
}

fn has_ending(path: &str, endings: &[&str]) -> bool {
    let ending = path.rsplit_once('.').map(|(_, ending)| ending.to_ascii_lowercase());
    ending.is_some_and(|ending| endings.contains(&ending.as_str()))
}

/// The name of a file without its folders, in lower case.
fn file_name(path: &str) -> String {
    path.rsplit('/').next().unwrap_or_default().to_lowercase()
}

/// A path without its extension, in lower case.
fn key(path: &str) -> String {
    stem(path).to_lowercase()
}

/// The candidates by their [`key`].
type Keys<'a> = BTreeMap<String, Vec<&'a str>>;

fn keys_of<'a>(candidates: &BTreeSet<&'a str>) -> Keys<'a> {
    let mut keys = Keys::new();
    for path in candidates {
        keys.entry(key(path)).or_default().push(path);
    }
    keys
}

/// The reason why a candidate is no photograph, if there is one.
type Reason = Result<Option<&'static str>, CaptureError>;

/// Whether a file is a map of depth or confidence: by its folder, or by its name beside a photograph.
fn map_reason(_: &CaptureFiles, path: &str, keys: &Keys<'_>) -> Reason {
    let key = key(path);
    let in_folder = key.split('/').rev().skip(1).any(|folder| MAP_FOLDERS.contains(&folder));
    let has_photo =
        || MAP_SUFFIXES.iter().any(|end| key.strip_suffix(end).is_some_and(|photo| keys.contains_key(photo)));
    Ok((in_folder || has_photo()).then_some(IS_MAP))
}

/// Whether a file is a HEIC or AVIF picture with a copy of another kind beside it: `IMG_1.JPG` or `IMG_1.HEIC.jpg` beside
/// `IMG_1.HEIC`. The copy is used, because it needs no converter.
fn phone_reason(_: &CaptureFiles, path: &str, keys: &Keys<'_>) -> Reason {
    let is_copy = |other: &&str| has_ending(other, &PHONE_COPIES);
    let has_copy = |key: String| keys.get(&key).is_some_and(|paths| paths.iter().any(is_copy));
    let is_phone_copy =
        has_ending(path, &PHONE_PICTURES) && (has_copy(key(path)) || has_copy(path.to_lowercase()));
    Ok(is_phone_copy.then_some(IS_PHONE_COPY))
}

/// Whether a file is a copy of a photograph in another folder: a smaller picture in `images_4` beside `images`, or `images`
/// beside `corrected_images`.
fn copy_reason(source: &CaptureFiles, path: &str, keys: &Keys<'_>) -> Reason {
    let key = key(path);
    let parts: Vec<&str> = key.split('/').collect();
    let with_folder = |at: usize, folder: &str| {
        let parts = parts.iter().enumerate().map(|(i, part)| if i == at { folder } else { part });
        parts.map(str::to_owned).collect::<Vec<_>>()
    };
    for at in 0..parts.len() - 1 {
        if parts[at] == "images" && keys.contains_key(&with_folder(at, "corrected_images").join("/")) {
            return Ok(Some(IS_UNCORRECTED));
        }
        let Some(folder) = reduced_folder(parts[at]) else { continue };
        let original = with_folder(at, folder);
        let original = match keys.get(&original.join("/")) {
            // Some programs rename the reduced copies of the folder `images`.
            None if folder == "images" => first_below(keys, &original[..=at].join("/")),
            named => named.and_then(|paths| paths.first().copied()),
        };
        if let Some(original) = original
            && is_smaller(source, path, original)?
        {
            return Ok(Some(IS_REDUCED));
        }
    }
    Ok(None)
}

/// The folder of the photographs for a folder of reduced copies: `images` for `images_4`.
fn reduced_folder(name: &str) -> Option<&str> {
    let (folder, factor) = name.rsplit_once('_')?;
    let is_factor = factor.parse::<u32>().is_ok_and(|factor| (2..=64).contains(&factor));
    (is_factor && PHOTO_FOLDERS.contains(&folder)).then_some(folder)
}

/// The first candidate in a folder.
fn first_below<'a>(keys: &Keys<'a>, folder: &str) -> Option<&'a str> {
    let start = format!("{folder}/");
    let (key, paths) = keys.range(start.clone()..).next()?;
    if key.starts_with(&start) { paths.first().copied() } else { None }
}

/// Whether a picture has fewer pixels than another, by their headers; false if a header cannot be read.
fn is_smaller(source: &CaptureFiles, path: &str, other: &str) -> Result<bool, CaptureError> {
    let area = |path: &str| match images::dimensions(source, path) {
        Ok((width, height)) => Ok(Some(u64::from(width) * u64::from(height))),
        Err(CaptureError::Image { .. }) => Ok(None),
        Err(error) => Err(error),
    };
    Ok(area(path)?.zip(area(other)?).is_some_and(|(area, other)| area < other))
}

/// Pictures outside the folder of the photographs that are none: plots, results and documents.
fn others<'a>(
    source: &CaptureFiles,
    candidates: &BTreeSet<&'a str>,
) -> Result<Vec<(&'a str, &'static str)>, CaptureError> {
    let mut folders: BTreeMap<&str, Vec<&'a str>> = BTreeMap::new();
    for path in candidates {
        folders.entry(folder_of(path)).or_default().push(path);
    }
    let Some((main, photos)) = folders.iter().max_by_key(|(_, photos)| photos.len()) else {
        return Ok(Vec::new());
    };
    let is_clear = photos.len() as f64 >= MAIN_SHARE * candidates.len() as f64;
    if !is_clear || photos.len() == candidates.len() {
        return Ok(Vec::new());
    }
    let step = photos.len().div_ceil(SAMPLES);
    let samples = photos.iter().step_by(step).map(|path| Picture::of(source, path));
    let samples = samples.collect::<Result<Vec<_>, _>>()?;
    let mut found = Vec::new();
    for path in candidates.iter().filter(|path| folder_of(path) != *main) {
        let reason = other_reason(path, main, &Picture::of(source, path)?, &samples);
        found.extend(reason.map(|reason| (*path, reason)));
    }
    Ok(found)
}

/// Whether a picture outside the main folder is no photograph, compared with samples of that folder.
fn other_reason(path: &str, main: &str, picture: &Picture, samples: &[Picture]) -> Option<&'static str> {
    let folder = folder_of(path);
    // `output/bottom` beside `output/top` is a second part of the photographs.
    let is_shared = |part: &str| main.split('/').any(|other| other.eq_ignore_ascii_case(part));
    let is_result = |part: &str| RESULT_FOLDERS.contains(&part.to_lowercase().as_str()) && !is_shared(part);
    if folder.split('/').any(is_result) {
        return Some(IS_RESULT);
    }
    let name = key(path.rsplit('/').next().unwrap_or(path));
    if SMALL_PICTURES.contains(&name.as_str()) {
        return Some(IS_SMALL_PICTURE);
    }
    if picture.is_grey && samples.iter().all(|sample| !sample.is_grey) {
        return Some(IS_GREY);
    }
    // A size that is not within the first bytes of a file is unknown.
    let mut known = samples.iter().filter_map(|sample| sample.sides).peekable();
    let has_other_size =
        picture.sides.is_some_and(|sides| known.peek().is_some() && known.all(|other| other != sides));
    let is_above = folder.is_empty() || main.starts_with(&format!("{folder}/"));
    let lacks_camera = !picture.has_camera && samples.iter().all(|sample| sample.has_camera);
    (has_other_size && (is_above || lacks_camera)).then_some(HAS_OTHER_SIZE)
}

fn folder_of(path: &str) -> &str {
    path.rsplit_once('/').map_or("", |(folder, _)| folder)
}

/// What the header of a picture states.
struct Picture {
    /// The shorter and the longer side, pixels; `None` if the header cannot be read.
    sides: Option<(u32, u32)>,
    is_grey: bool,
    /// Whether EXIF names a camera.
    has_camera: bool,
}

impl Picture {
    fn of(source: &CaptureFiles, path: &str) -> Result<Self, CaptureError> {
        let bytes = source.read_start(path, images::HEAD)?;
        let sides = image_file::dimensions(&bytes).ok().map(|(w, h)| (w.min(h), w.max(h)));
        let has_camera = exif_data::read(&bytes).camera.is_some();
        Ok(Self { sides, is_grey: image_file::is_grey(&bytes), has_camera })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ImportLimits;
    use crate::formats::image_file::encode_png;

    /// The photographs among files, and the others with their reasons. A file is a picture with colours of 8 x 6 pixels,
    /// or as `special` states.
    fn selected(files: &[&str], special: &[(&str, Vec<u8>)]) -> (Vec<String>, Vec<(String, &'static str)>) {
        let folder = tempfile::TempDir::new().unwrap();
        let picture = encode_png(8, 6, &[[1u8, 2, 3]; 48]).unwrap();
        let all = files
            .iter()
            .map(|file| (*file, &picture))
            .chain(special.iter().map(|(file, bytes)| (*file, bytes)));
        for (file, bytes) in all {
            let path = folder.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, bytes).unwrap();
        }
        let source = CaptureFiles::open(folder.path(), &ImportLimits::default()).unwrap();
        let Selection { photos, ignored } = select(&source).unwrap();
        (photos, ignored.into_iter().map(|file| (file.path, file.reason)).collect())
    }

    fn pair(path: &str, reason: &'static str) -> (String, &'static str) {
        (path.to_owned(), reason)
    }

    fn of_size(width: u32, height: u32) -> Vec<u8> {
        encode_png(width, height, &vec![[1u8, 2, 3]; (width * height) as usize]).unwrap()
    }

    #[test]
    fn reduced_copies_of_photographs_are_ignored() {
        let files = ["images/a.jpg", "images/b.jpg"];
        let copies = [("images_2/a.jpg", of_size(4, 3)), ("images_8/image000.png", of_size(1, 1))];
        let (photos, ignored) = selected(&files, &copies);
        assert_eq!(photos, files);
        assert_eq!(ignored, [pair("images_2/a.jpg", IS_REDUCED), pair("images_8/image000.png", IS_REDUCED)]);
        let (photos, ignored) = selected(&["x/images_4/a.jpg", "x/images_4/b.jpg"], &[]);
        assert_eq!((photos.len(), ignored.len()), (2, 0), "the control: there is no larger copy");
        let (photos, _) = selected(&["day_2/a.jpg", "day/a.jpg"], &[]);
        assert_eq!(photos.len(), 2, "the control: other photographs");
    }

    #[test]
    fn second_session_of_equal_size_is_no_reduced_copy() {
        let files = ["images/a.jpg", "images/b.jpg", "images_2/a.jpg", "images_3/c.jpg"];
        let (photos, ignored) = selected(&files, &[("images_2/b.jpg", of_size(6, 8))]);
        assert_eq!((photos.len(), ignored), (5, vec![]));
        let (_, ignored) = selected(&files, &[("images_2/b.jpg", of_size(4, 3))]);
        assert_eq!(ignored, [pair("images_2/b.jpg", IS_REDUCED)], "the control");
        let (photos, _) = selected(&files, &[("images_2/b.jpg", b"damaged".to_vec())]);
        assert_eq!(photos.len(), 5, "a file without a size is not dropped");
    }

    #[test]
    fn phone_pictures_beside_their_copies_are_ignored() {
        let files =
            ["IMG_1.HEIC", "IMG_1.JPG", "b/IMG_2.HEIC", "b/IMG_2.HEIC.jpg", "IMG_3.avif", "img_3.png"];
        let (photos, ignored) = selected(&files, &[]);
        assert_eq!(photos, ["IMG_1.JPG", "b/IMG_2.HEIC.jpg", "img_3.png"]);
        let copies = ["IMG_1.HEIC", "IMG_3.avif", "b/IMG_2.HEIC"];
        assert_eq!(ignored, copies.map(|path| pair(path, IS_PHONE_COPY)));
        let files = ["IMG_1.HEIC", "b/IMG_1.JPG", "IMG_2.heic", "IMG_2.webp", "IMG_3.HEIC", "IMG_30.JPG"];
        assert_eq!(selected(&files, &[]).1, [], "the control: no copies");
    }

    #[test]
    fn depth_and_confidence_maps_are_ignored() {
        let files = [
            "k/images/1.jpg",
            "k/corrected_images/1.jpg",
            "k/depth/1.png",
            "k/confidence/1.png",
            "k/cameras/1.json",
        ];
        let (photos, ignored) = selected(&files, &[]);
        assert_eq!(photos, ["corrected_images/1.jpg"]);
        let reasons =
            [("confidence/1.png", IS_MAP), ("depth/1.png", IS_MAP), ("images/1.jpg", IS_UNCORRECTED)];
        assert_eq!(ignored, reasons.map(|(path, reason)| pair(path, reason)));
        let (photos, ignored) =
            selected(&["images/1.png", "images/1.depth.png", "images/2_depth.png", "notes.txt"], &[]);
        assert_eq!(photos, ["images/1.png", "images/2_depth.png"], "a map has a photograph");
        assert_eq!(ignored, [pair("images/1.depth.png", IS_MAP)]);
        let (photos, ignored) = selected(&["depth/1.png", "depth/2.png"], &[]);
        assert_eq!((photos.len(), ignored.len()), (2, 0), "the control: nothing else is there");
    }

    #[test]
    fn raw_files_and_unread_images_are_named() {
        let files =
            ["IMG_1.JPG", "IMG_1.DNG", "IMG_2.CR2", "IMG_3.heic", "old.gif", "notes.txt", "Cameras.xml"];
        let (photos, ignored) = selected(&files, &[]);
        assert_eq!(photos, ["IMG_1.JPG", "IMG_3.heic"]);
        let reasons = [
            ("Cameras.xml", HAS_POSES),
            ("IMG_1.DNG", IS_RAW_COPY),
            ("IMG_2.CR2", IS_RAW),
            ("old.gif", IS_UNREAD),
        ];
        assert_eq!(ignored, reasons.map(|(path, reason)| pair(path, reason)));
    }

    #[test]
    fn plots_outside_the_folder_of_the_photographs_are_ignored() {
        let files: Vec<String> = (0..14).map(|i| format!("images/{i:02}.png")).collect();
        let files: Vec<&str> = files.iter().map(String::as_str).collect();
        let grey = encode_png(8, 6, &[[1u8]; 48]).unwrap();
        for (path, bytes, reason) in [
            ("results/plot.png", of_size(8, 6), Some(IS_RESULT)),
            ("other/plot.png", grey.clone(), Some(IS_GREY)),
            ("plot.png", of_size(9, 6), Some(HAS_OTHER_SIZE)),
            ("thumbnail.jpg", of_size(8, 6), Some(IS_SMALL_PICTURE)),
            ("images/00b.png", of_size(9, 6), None),
            ("other/upright.png", of_size(6, 8), None),
            ("closeups/a.png", of_size(9, 6), None),
            ("plot.png", b"no picture".to_vec(), None),
        ] {
            let (photos, ignored) = selected(&files, &[(path, bytes)]);
            assert_eq!(
                ignored,
                reason.map(|reason| pair(path, reason)).into_iter().collect::<Vec<_>>(),
                "{path}"
            );
            assert_eq!(photos.len() + ignored.len(), 15);
        }
        let (photos, ignored) = selected(&["a/1.png", "a/2.png", "results/3.png"], &[]);
        assert_eq!((photos.len(), ignored.len()), (3, 0), "the control: no clear majority");
    }

    #[test]
    fn folders_shared_with_the_photographs_are_no_results() {
        let files: Vec<String> = (0..14).map(|i| format!("day/output/top/{i:02}.png")).collect();
        let mut files: Vec<&str> = files.iter().map(String::as_str).collect();
        files.extend(["day/output/bottom/1.png", "night/Output/2.png"]);
        assert_eq!(selected(&files, &[]).1, []);
        files.push("day/output/plots/3.png");
        assert_eq!(selected(&files, &[]).1.len(), 1, "the control");
    }
}
