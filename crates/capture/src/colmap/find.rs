//! Finds the sparse model among the files of a capture.

use std::collections::BTreeMap;

use super::text::TextFile;
use crate::CaptureFiles;

/// Folders in which COLMAP and programs beside it write models, best first. Each may contain numbered folders.
const FOLDERS: [&str; 9] = [
    "sparse",
    "",
    "colmap/sparse",
    "dense/sparse",
    "dense/0/sparse",
    "undistorted/sparse",
    "sfm",
    "colmap",
    "colmap/text",
];
/// Number of models whose images are counted.
const MOST_COUNTED: usize = 64;
/// Least number of images with which a model in a better folder is preferred to a larger one elsewhere.
const ENOUGH: usize = 3;

/// Encoding of the files of a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum ModelEncoding {
    Binary,
    Text,
}

impl ModelEncoding {
    fn ending(self) -> &'static str {
        match self {
            Self::Binary => "bin",
            Self::Text => "txt",
        }
    }
}

/// The files of a sparse model.
#[derive(Debug, Clone)]
pub(crate) struct ModelFiles {
    /// Folder of the model, with `/` at its end unless it is the capture's own.
    folder: String,
    pub(super) encoding: ModelEncoding,
    /// A warning about other models that are not used.
    pub(super) unused: Option<String>,
}

impl ModelFiles {
    /// Path of the model's file `name`, e.g. `cameras`.
    pub(super) fn path(&self, name: &str) -> String {
        format!("{}{name}.{}", self.folder, self.encoding.ending())
    }

    /// Folders that may contain the photographs, best first, each with `/` at its end: first those beside an undistorted model.
    pub(super) fn photo_folders(&self) -> Vec<String> {
        let parents = self.folder.trim_end_matches('/').split('/').collect::<Vec<_>>();
        let beside =
            (0..parents.len()).rev().map(|n| parents[..n].iter().map(|part| format!("{part}/")).collect());
        let mut folders = Vec::new();
        for root in beside.filter(|root: &String| !root.is_empty()) {
            folders.extend(["images/", "rgb/"].map(|name| format!("{root}{name}")));
        }
        folders.extend(["images/", "", "input/", "images_2/", "images_4/", "images_8/"].map(str::to_owned));
        folders
    }
}

/// A model with its number of images.
struct Candidate {
    folder: String,
    encoding: ModelEncoding,
    images: usize,
}

/// The files of the best sparse model, if there is one: the model with the most images in the best folder of [`FOLDERS`].
pub(crate) fn find(source: &CaptureFiles) -> Option<ModelFiles> {
    let mut places: BTreeMap<(usize, usize, String), Vec<Candidate>> = BTreeMap::new();
    for candidate in candidates(source) {
        let place = place(&candidate.folder);
        let rank = FOLDERS.iter().position(|known| *known == place).unwrap_or(FOLDERS.len());
        // 3D Gaussian Splatting's converter keeps the model of the distorted photographs in `distorted`.
        let depth =
            place.split('/').count() + 100 * usize::from(place.split('/').any(|part| part == "distorted"));
        places.entry((rank, depth, place)).or_default().push(candidate);
    }
    let most = |candidates: &Vec<Candidate>| candidates.iter().map(|c| c.images).max().unwrap_or(0);
    let chosen = places.values().position(|place| most(place) >= ENOUGH).unwrap_or(0);
    let mut candidates: Vec<Candidate> = places.into_values().nth(chosen)?;
    candidates.sort_by(|a, b| (b.images, &a.folder, a.encoding).cmp(&(a.images, &b.folder, b.encoding)));
    let best = candidates.first()?;
    let others = candidates.iter().filter(|other| other.folder != best.folder);
    let others: Vec<String> = others.map(|other| format!("{} with {}", other.folder, other.images)).collect();
    let unused = (!others.is_empty()).then(|| {
        let others = others.join(", ");
        format!(
            "COLMAP made several models; {} with {} images is used, not used: {others}",
            best.folder, best.images
        )
    });
    Some(ModelFiles { folder: best.folder.clone(), encoding: best.encoding, unused })
}

/// All models.
fn candidates(source: &CaptureFiles) -> Vec<Candidate> {
    let mut found = Vec::new();
    for encoding in [ModelEncoding::Binary, ModelEncoding::Text] {
        let name = format!("cameras.{}", encoding.ending());
        for path in source.paths() {
            let Some(folder) = path.strip_suffix(&name).filter(|f| f.is_empty() || f.ends_with('/')) else {
                continue;
            };
            let images = format!("{folder}images.{}", encoding.ending());
            if source.contains(&images) {
                // The files of text models are read completely to count their images.
                let images = if found.len() < MOST_COUNTED { count(source, &images, encoding) } else { 0 };
                found.push(Candidate { folder: folder.to_owned(), encoding, images });
            }
        }
    }
    found
}

/// Number of images that a model states; 0 if its file cannot be read.
fn count(source: &CaptureFiles, images: &str, encoding: ModelEncoding) -> usize {
    match encoding {
        ModelEncoding::Binary => {
            let start = source.read_start(images, 8).unwrap_or_default();
            start.first_chunk().map_or(0, |count| usize::try_from(u64::from_le_bytes(*count)).unwrap_or(0))
        }
        ModelEncoding::Text => {
            let bytes = source.read(images).unwrap_or_default();
            TextFile::new(images, &bytes).map_or(0, |text| text.image_lines().count())
        }
    }
}

/// A model's folder without the number of the model and without `/` at its end.
fn place(folder: &str) -> String {
    let folder = folder.trim_end_matches('/');
    let (parent, name) = folder.rsplit_once('/').unwrap_or(("", folder));
    let is_number = !name.is_empty() && name.bytes().all(|b| b.is_ascii_digit());
    if is_number { parent.to_owned() } else { folder.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ImportLimits;

    /// The folder of the model that is found among empty files and models with so many images.
    fn found(models: &[(&str, u64)]) -> Option<(String, Option<String>)> {
        let folder = tempfile::TempDir::new().unwrap();
        for (model, images) in models {
            let model = folder.path().join(model);
            std::fs::create_dir_all(&model).unwrap();
            std::fs::write(model.join("cameras.bin"), b"").unwrap();
            std::fs::write(model.join("images.bin"), images.to_le_bytes()).unwrap();
        }
        std::fs::write(folder.path().join("readme.txt"), b"").unwrap();
        let source = CaptureFiles::open(folder.path(), &ImportLimits::default()).unwrap();
        find(&source).map(|files| (files.folder, files.unused))
    }

    #[test]
    fn model_with_the_most_images_in_the_best_folder_is_used() {
        for (models, chosen) in [
            (&[("sparse/0", 4), ("sparse/1", 14)][..], "sparse/1/"),
            (&[("sparse/0", 14), ("sparse/1", 4)], "sparse/0/"),
            (&[("sparse/0", 14), ("distorted/sparse/0", 20)], "sparse/0/"),
            (&[("sparse/0", 2), ("colmap/sparse/0", 20)], "colmap/sparse/0/"),
            (&[("a/distorted/sparse/0", 14), ("a/b/c/sparse/3", 14)], "a/b/c/sparse/3/"),
            (&[("x/distorted/sparse/0", 14), ("x/undistorted/sparse/0", 14)], "x/undistorted/sparse/0/"),
            (&[("dense/sparse", 14)], "dense/sparse/"),
            (&[("", 14)], ""),
        ] {
            let (folder, unused) = found(models).unwrap();
            assert_eq!(folder, chosen, "{models:?}");
            assert_eq!(
                unused.is_some(),
                models.iter().filter(|(m, _)| place(m) == place(chosen)).count() > 1
            );
        }
        let (_, unused) = found(&[("sparse/0", 4), ("sparse/1", 14)]).unwrap();
        let expected =
            "COLMAP made several models; sparse/1/ with 14 images is used, not used: sparse/0/ with 4";
        assert_eq!(unused.as_deref(), Some(expected));
        assert!(found(&[]).is_none());
    }

    #[test]
    fn photographs_beside_the_model_come_first() {
        let files = |folder: &str| ModelFiles {
            folder: folder.to_owned(),
            encoding: ModelEncoding::Binary,
            unused: None,
        };
        assert_eq!(files("dense/sparse/").photo_folders()[0], "dense/images/");
        assert_eq!(files("sparse/0/").photo_folders()[2..4], ["images/", ""], "the control");
    }
}
