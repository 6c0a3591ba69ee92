//! Finds the photographs that a capture's files name, also where a name differs from the file's path: by upper or lower case, by
//! its extension, by Unicode normalisation, by folders that have moved.

use std::collections::{BTreeMap, BTreeSet};

use unicode_normalization::UnicodeNormalization;

use crate::error::name_list;
use crate::selection::PHOTOGRAPHS;
use crate::text::shown;
use crate::{CaptureError, CaptureFiles, masks};

/// Least number of photographs in a capture.
pub(super) const MIN_IMAGES: usize = 3;
/// Endings that names of photographs omit. The last two add the name of a light.
const OMITTED: [&str; 9] =
    [".png", ".jpg", ".jpeg", ".webp", ".exr", ".JPG", ".PNG", "_sunset.png", "_sunset_000.png"];
/// Folders with maps that are no photographs.
const OTHER_FOLDERS: [&str; 6] = ["depth", "disparity", "normal", "confidence", "conf", "sparse"];
/// Number of photographs of one file name that are compared with a stated name.
const MOST_CANDIDATES: usize = 64;
/// Start of the names of folders that contain reduced copies of `images`.
const REDUCED: &str = "images_";

/// A photograph of the capture.
struct Candidate<'a> {
    path: &'a str,
    /// [`keys`] of its path.
    keys: Vec<String>,
}

/// Finds photographs by the names that one file states.
pub(super) struct PhotoFinder<'a> {
    source: &'a CaptureFiles,
    /// Folders in which the photographs may be, each with `/` at its end.
    folders: Vec<String>,
    /// Whether a photograph must be in its stated folder, so that only case, extension and Unicode form may differ.
    same_folders: bool,
    /// Paths of photographs by [`key`] of their file name; built for the first name that has no file.
    index: Option<BTreeMap<String, Vec<Candidate<'a>>>>,
    /// Names whose file has another path.
    renamed: Vec<(String, String)>,
    /// Names without a file.
    missing: Vec<String>,
}

impl<'a> PhotoFinder<'a> {
    /// Looks for photographs in `folders`, in this order, then everywhere.
    pub(super) fn new(source: &'a CaptureFiles, folders: Vec<String>) -> Self {
        Self { source, folders, same_folders: false, index: None, renamed: Vec::new(), missing: Vec::new() }
    }

    /// The same finder, for files whose folders tell photographs of one name apart, e.g. `train/1.png` and `test/1.png`.
    pub(super) fn with_same_folders(self) -> Self {
        Self { same_folders: true, ..self }
    }

    /// The paths of the photographs that a file calls `names`. A file that one of them names exactly is not taken for another.
    pub(super) fn find_all(&mut self, names: &[&str]) -> Vec<Option<String>> {
        let exact: Vec<Option<String>> = names.iter().map(|name| self.exact(name)).collect();
        let mut taken: BTreeSet<String> = exact.iter().flatten().cloned().collect();
        // Where some files have their stated folders, a file of another folder is another photograph.
        self.same_folders |= !taken.is_empty();
        let or_similar = |(path, name): (Option<String>, &&str)| {
            path.or_else(|| {
                let path = self.find_similar(name, &taken)?;
                taken.insert(path.clone());
                Some(path)
            })
        };
        exact.into_iter().zip(names).map(or_similar).collect()
    }

    fn find_similar(&mut self, name: &str, taken: &BTreeSet<String>) -> Option<String> {
        match self.similar(name, taken)[..] {
            [path] => {
                self.renamed.push((shown(name), shown(path)));
                Some(path.to_owned())
            }
            [] => {
                self.missing.push(shown(name));
                None
            }
            [first, second, ..] => {
                self.missing.push(format!(
                    "{} (it may be {} or {})",
                    shown(name),
                    shown(first),
                    shown(second)
                ));
                None
            }
        }
    }

    /// The path as written, in one of the folders, or with an omitted ending.
    fn exact(&self, name: &str) -> Option<String> {
        let paths = self.folders.iter().map(|folder| format!("{folder}{name}"));
        paths.into_iter().find_map(|path| {
            if self.source.contains(&path) {
                return Some(path);
            }
            OMITTED.iter().map(|ending| format!("{path}{ending}")).find(|path| self.source.contains(path))
        })
    }

    /// The photographs whose names agree best with `name`, from the file name upwards.
    fn similar(&mut self, name: &str, taken: &BTreeSet<String>) -> Vec<&'a str> {
        let source = self.source;
        let index = self.index.get_or_insert_with(|| index(source));
        let wanted: Vec<String> = keys(name).collect();
        let Some(candidates) = wanted.first().and_then(|name| index.get(name)) else { return Vec::new() };
        let stated: Vec<Vec<String>> =
            self.folders.iter().map(|folder| keys(&format!("{folder}{name}")).collect()).collect();
        let free = candidates.iter().take(MOST_CANDIDATES).filter(|candidate| {
            let is_meant = !self.same_folders || stated.contains(&candidate.keys);
            is_meant && !taken.contains(candidate.path)
        });
        let agreement = |candidate: &Candidate<'_>| {
            candidate.keys.iter().zip(&wanted).take_while(|(a, b)| a == b).count()
        };
        let agreeing: Vec<(usize, &str)> =
            free.map(|candidate| (agreement(candidate), candidate.path)).collect();
        let best = agreeing.iter().map(|(n, _)| *n).max().unwrap_or(0);
        let mut found: Vec<&str> =
            agreeing.iter().filter(|(n, _)| *n == best).map(|(_, path)| *path).collect();
        if found.len() > 1 {
            // A file with the stated extension is meant, and the original rather than a reduced copy.
            let has_ending = |path: &&str| extension(path) == extension(name);
            let is_original = |path: &&str| !path.starts_with(REDUCED) && !path.contains("/images_");
            for is_meant in [&has_ending as &dyn Fn(&&str) -> bool, &is_original] {
                if found.iter().any(is_meant) {
                    found.retain(is_meant);
                }
            }
        }
        found
    }

    /// Adds warnings about missing and renamed photographs of `file`, of which `usable` were found.
    ///
    /// # Errors
    /// [`CaptureError::TooFewImages`] when fewer than [`MIN_IMAGES`] were found.
    pub(super) fn finish(
        self,
        file: &str,
        usable: usize,
        warnings: &mut Vec<String>,
    ) -> Result<(), CaptureError> {
        if usable < MIN_IMAGES {
            let (file, missing) = (file.to_owned(), self.missing);
            return Err(CaptureError::TooFewImages { file, usable, required: MIN_IMAGES, missing });
        }
        if !self.missing.is_empty() {
            let (count, names) = (self.missing.len(), name_list(&self.missing));
            let all = usable + count;
            warnings.push(format!("missing photographs that {file} names: {count} of {all}: {names}"));
        }
        if let Some((name, path)) = self.renamed.first() {
            let count = self.renamed.len();
            warnings.push(format!(
                "{file} states other paths than the files have; photographs found by their names: {count}, e.g. {name} as {path}"
            ));
        }
        Ok(())
    }
}

/// All photographs by the key of their file name.
fn index(source: &CaptureFiles) -> BTreeMap<String, Vec<Candidate<'_>>> {
    let is_photo = |path: &&str| {
        let in_other = path.split('/').rev().skip(1).any(|folder| {
            let folder = folder.to_lowercase();
            OTHER_FOLDERS.iter().any(|other| folder.starts_with(other))
        });
        !in_other && extension(path).is_some_and(|ending| is_photo_ending(&ending))
    };
    let mut index: BTreeMap<String, Vec<Candidate<'_>>> = BTreeMap::new();
    for path in masks::separate(source.paths().filter(is_photo)) {
        let keys: Vec<String> = keys(path).collect();
        if let Some(key) = keys.first() {
            index.entry(key.clone()).or_default().push(Candidate { path, keys });
        }
    }
    index
}

/// The parts of a path from the file name upwards, in a form in which equal names are equal: without extension, lower case,
/// composed characters.
fn keys(path: &str) -> impl Iterator<Item = String> + '_ {
    let parts = path.rsplit(['/', '\\']).filter(|part| !part.is_empty());
    parts.enumerate().map(|(i, part)| {
        let part = if i == 0 && extension(part).is_some_and(|ending| is_photo_ending(&ending)) {
            part.rsplit_once('.').map_or(part, |(stem, _)| stem)
        } else {
            part
        };
        part.nfc().collect::<String>().to_lowercase()
    })
}

/// Whether an extension, in lower case, is that of a photograph whose poses a layout may state.
fn is_photo_ending(ending: &str) -> bool {
    PHOTOGRAPHS.contains(&ending) || ending == "exr"
}

fn extension(path: &str) -> Option<String> {
    path.rsplit_once('.').map(|(_, ending)| ending.to_ascii_lowercase())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ImportLimits;

    /// The file that each name of `names` means among `files`, and the warnings.
    fn found(files: &[&str], names: &[&str]) -> (Vec<Option<String>>, Vec<String>) {
        let folder = tempfile::TempDir::new().unwrap();
        for file in files {
            let path = folder.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, b"x").unwrap();
        }
        let source = CaptureFiles::open(folder.path(), &ImportLimits::default()).unwrap();
        let mut finder = PhotoFinder::new(&source, vec![String::new()]);
        let paths = finder.find_all(names);
        let mut warnings = Vec::new();
        finder.finish("list.json", 9, &mut warnings).unwrap();
        (paths, warnings)
    }

    #[test]
    fn photographs_are_found_under_similar_names() {
        let files = ["images/A.JPG", "images/b.png", "images/caf\u{65}\u{301}.png", "masks/b.png", "x.txt"];
        for (name, path) in [
            ("images/a.jpg", "images/A.JPG"),
            ("images/b.jpg", "images/b.png"),
            ("b", "images/b.png"),
            ("C:/thing/images/b.png", "images/b.png"),
            ("/home/me/b.png", "images/b.png"),
            ("images/caf\u{e9}.png", "images/caf\u{65}\u{301}.png"),
        ] {
            let (paths, warnings) = found(&files, &[name]);
            assert_eq!(paths, [Some(path.to_owned())], "{name}");
            assert!(
                warnings.len() == 1 && warnings[0].ends_with(&format!("{name} as {path}")),
                "{warnings:?}"
            );
        }
        let (paths, warnings) = found(&files, &["images/b.png", "images/b", "images/c.png", "y.txt"]);
        let expected = [Some("images/b.png".to_owned()), Some("images/b.png".to_owned()), None, None];
        assert_eq!(paths, expected, "the control: these names need no search, or have no file");
        assert_eq!(warnings, ["missing photographs that list.json names: 2 of 11: images/c.png, y.txt"]);
    }

    #[test]
    fn a_photograph_that_is_named_is_not_taken_for_another() {
        let (paths, _) = found(&["train/1.png", "x.txt"], &["test/1.png", "train/1.png"]);
        assert_eq!(paths, [None, Some("train/1.png".to_owned())]);
        let (paths, _) = found(&["2.png", "x.txt"], &["a/2.png", "b/2.png"]);
        assert_eq!(paths, [Some("2.png".to_owned()), None], "one file is one photograph");
        let (paths, _) = found(&["train/1.png", "x.txt"], &["test/1.png"]);
        assert_eq!(paths[0].as_deref(), Some("train/1.png"), "the control");
    }

    #[test]
    fn photographs_that_were_moved_away_are_missing() {
        let files = ["images/1.png", "images/2.JPG", "rejected/3.png"];
        let (paths, _) = found(&files, &["images/1.png", "images/2.png", "images/3.png"]);
        let expected = [Some("images/1.png".to_owned()), Some("images/2.JPG".to_owned()), None];
        assert_eq!(paths, expected);
        let (paths, _) = found(&files, &["photos/3.png"]);
        assert_eq!(
            paths[0].as_deref(),
            Some("rejected/3.png"),
            "the control: no file is in its stated folder"
        );
    }

    #[test]
    fn ambiguous_names_are_not_guessed() {
        let files = ["a/1.png", "b/1.png", "a/2.jpg", "b/2.png", "images_4/3.png", "images/3.png"];
        let (paths, warnings) = found(&files, &["c/1.png", "c/2.png", "c/3.png"]);
        assert_eq!(paths[0], None);
        assert_eq!(paths[1].as_deref(), Some("b/2.png"), "the stated extension decides");
        assert_eq!(paths[2].as_deref(), Some("images/3.png"), "the original, not a reduced copy");
        assert!(warnings[0].ends_with("c/1.png (it may be a/1.png or b/1.png)"), "{warnings:?}");
    }
}
