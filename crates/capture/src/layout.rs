//! Finds which layout a capture has, and where.

use std::path::Path;

use crate::colmap::{self, ModelFiles};
use crate::polycam::{self, PolycamFolders};
use crate::{CaptureError, CaptureFiles, ImportLimits, blender, llff, nerfstudio};

/// A layout that was found, with the path of the file that marks it.
pub(super) enum FoundLayout {
    Blender(String),
    Nerfstudio(String),
    Colmap(ModelFiles),
    Llff(String),
    Polycam(PolycamFolders),
}

/// The layout of a capture: first those whose file is in the capture's own folder, then those in other folders.
///
/// # Errors
/// Names the files if several folders have a layout, so that none can be chosen.
pub(super) fn find(source: &CaptureFiles) -> Result<Option<FoundLayout>, CaptureError> {
    type Kind = fn(String) -> FoundLayout;
    let [blender, nerfstudio, llff]: [(&str, Kind); 3] = [
        (blender::MARKER, FoundLayout::Blender),
        (nerfstudio::MARKER, FoundLayout::Nerfstudio),
        (llff::MARKER, FoundLayout::Llff),
    ];
    let here = |(marker, kind): (&str, Kind)| source.contains(marker).then(|| kind(marker.to_owned()));
    let there = |(marker, kind): (&str, Kind)| Ok(elsewhere(source, marker)?.map(kind));
    if let Some(found) = here(blender).or_else(|| here(nerfstudio)) {
        return Ok(Some(found));
    }
    if let Some(files) = colmap::find(source) {
        return Ok(Some(FoundLayout::Colmap(files)));
    }
    if let Some(found) = here(llff) {
        return Ok(Some(found));
    }
    for layout in [blender, nerfstudio, llff] {
        if let Some(found) = there(layout)? {
            return Ok(Some(found));
        }
    }
    if let Some(marker) = other_transforms(source)? {
        return Ok(Some(FoundLayout::Nerfstudio(marker)));
    }
    if let Some(test) = source.paths().find(|path| path.ends_with("transforms_test.json")) {
        let reason = format!("is missing beside {test}; the test views alone are not a capture");
        return Err(CaptureError::File { file: blender::MARKER.to_owned(), reason });
    }
    Ok(polycam::find(source).map(FoundLayout::Polycam))
}

/// Whether a layout is present, valid or not.
pub(super) fn is_present(source: &CaptureFiles) -> bool {
    !matches!(find(source), Ok(None))
}

/// Whether a folder, zip, tar or tar.gz has a layout with poses, valid or not.
///
/// # Errors
/// [`CaptureError`] when it cannot be opened or is over a limit.
pub fn has_poses(path: &Path, limits: &ImportLimits) -> Result<bool, CaptureError> {
    Ok(is_present(&CaptureFiles::open(path, limits)?))
}

/// The only file of a name in any folder.
fn elsewhere(source: &CaptureFiles, name: &str) -> Result<Option<String>, CaptureError> {
    only(source, source.paths().filter(|path| path.rsplit('/').next() == Some(name)).collect())
}

/// The only JSON file that is named like `transforms_1.json`.
fn other_transforms(source: &CaptureFiles) -> Result<Option<String>, CaptureError> {
    let is_other = |path: &&str| {
        let name = path.rsplit('/').next().unwrap_or_default().to_lowercase();
        let part = name.strip_prefix("transforms").and_then(|rest| rest.strip_suffix(".json"));
        part.is_some_and(|part| !["_train", "_test", "_val"].contains(&part))
    };
    only(source, source.paths().filter(is_other).collect())
}

fn only(source: &CaptureFiles, paths: Vec<&str>) -> Result<Option<String>, CaptureError> {
    match paths[..] {
        [] => Ok(None),
        [path] => Ok(Some(path.to_owned())),
        _ => {
            let reason = format!("contains several captures; keep one of {}", paths.join(", "));
            Err(CaptureError::File { file: source.label().to_owned(), reason })
        }
    }
}

/// The folder of a file, with `/` at its end; empty for the capture's own.
pub(super) fn folder_of(path: &str) -> String {
    path.rsplit_once('/').map_or_else(String::new, |(folder, _)| format!("{folder}/"))
}
