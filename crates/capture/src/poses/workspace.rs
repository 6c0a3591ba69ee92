//! The folder that becomes a capture: `images/`, `masks/` and, at the end, `sparse/0/`.

use std::fs;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::error::PoseError;
use super::run_control::RunControl;
use crate::formats::image_file;
use crate::{CaptureError, PhotosWithoutPoses, masks};

/// Number of photographs that are copied at once. The work can be cancelled between two such groups.
const GROUP: usize = 2;

/// The folder of an unfinished capture.
pub(super) struct Workspace {
    root: PathBuf,
}

impl Workspace {
    /// Creates `root` and copies photographs and masks into it. The results of an earlier run are kept.
    ///
    /// # Errors
    /// [`PoseError::FolderNotEmpty`] if the folder contains other photographs; [`PoseError::Cancelled`] between two
    /// photographs.
    pub(super) fn fill(
        root: &Path,
        photographs: &PhotosWithoutPoses,
        run_control: &RunControl<'_>,
    ) -> Result<Self, PoseError> {
        let workspace = Self { root: root.to_owned() };
        let wanted: Vec<PathBuf> = photographs
            .photos()
            .map(|name| workspace.images().join(photographs.converted_name(name)))
            .collect();
        for other in files_below(&workspace.images())?.into_iter().filter(|file| !wanted.contains(file)) {
            // A partial copy that an interrupted run left.
            if other.extension().is_some_and(|e| e == PARTIAL) {
                fs::remove_file(&other).map_err(PoseError::io(&other))?;
            } else {
                return Err(PoseError::FolderNotEmpty(root.to_owned()));
            }
        }
        if workspace.is_done() && wanted.iter().any(|file| !file.is_file()) {
            return Err(PoseError::FolderNotEmpty(root.to_owned()));
        }
        let names: Vec<&str> = photographs.photos().collect();
        for (names, files) in names.chunks(GROUP).zip(wanted.chunks(GROUP)) {
            check_cancelled(run_control)?;
            let copied: Vec<_> =
                names.par_iter().zip(files).map(|(name, file)| copy(photographs, name, file)).collect();
            copied.into_iter().collect::<Result<(), _>>().map_err(|error| match error {
                PoseError::FolderNotEmpty(_) => PoseError::FolderNotEmpty(root.to_owned()),
                other => other,
            })?;
        }
        for (mask, of) in photographs.masks() {
            check_cancelled(run_control)?;
            let png = masks::as_png(mask, photographs.read(&mask.path)?)?;
            let name = format!("{}.png", photographs.converted_name(of));
            keep(&root.join("masks").join(name), &png)?;
        }
        Ok(workspace)
    }

    /// The folder with the photographs.
    pub(super) fn images(&self) -> PathBuf {
        self.root.join("images")
    }

    /// The folder of the sparse model, which is complete once it exists.
    pub(super) fn model(&self) -> PathBuf {
        self.root.join("sparse").join("0")
    }

    /// COLMAP's output.
    pub(super) fn log(&self) -> PathBuf {
        self.root.join("colmap.log")
    }

    /// File with the process id of the COLMAP that runs in this workspace.
    pub(super) fn marker(&self) -> PathBuf {
        self.scratch().join("process")
    }

    /// Folder of COLMAP's intermediate files, removed at the end.
    pub(super) fn scratch(&self) -> PathBuf {
        self.root.join("colmap")
    }

    /// True if an earlier run completed.
    pub(super) fn is_done(&self) -> bool {
        self.model().is_dir()
    }

    /// Moves `model`, a folder in the scratch folder, to its final path and removes the scratch folder.
    pub(super) fn finish(&self, model: &Path) -> Result<(), PoseError> {
        let sparse = self.root.join("sparse");
        fs::create_dir_all(&sparse).map_err(PoseError::io(&sparse))?;
        fs::rename(model, self.model()).map_err(PoseError::io(model))?;
        fs::remove_dir_all(self.scratch()).map_err(PoseError::io(&self.scratch()))
    }
}

fn check_cancelled(run_control: &RunControl<'_>) -> Result<(), PoseError> {
    if (run_control.is_cancelled)() { Err(PoseError::Cancelled) } else { Ok(()) }
}

/// Copies a photograph; COLMAP reads neither HEIC nor AVIF, so these become JPEG files. A file that an earlier run converted
/// is kept, because a conversion takes long and another version of the converter writes other bytes.
fn copy(photographs: &PhotosWithoutPoses, name: &str, file: &Path) -> Result<(), PoseError> {
    if !photographs.is_heif(name) {
        return keep(file, &photographs.read(name)?);
    }
    if file.is_file() {
        return Ok(());
    }
    let bytes = photographs.read(name)?;
    let jpeg = image_file::heif_as_jpeg(&bytes, photographs.limits().max_image_pixels);
    keep(file, &jpeg.map_err(|error| CaptureError::image(name, error))?)
}

/// Extension of a file that is being written.
const PARTIAL: &str = "relume-tmp";

/// Writes a file atomically. An existing file must have the same contents.
fn keep(file: &Path, bytes: &[u8]) -> Result<(), PoseError> {
    if file.is_file() {
        let same = fs::read(file).map_err(PoseError::io(file))? == bytes;
        return if same { Ok(()) } else { Err(PoseError::FolderNotEmpty(file.to_owned())) };
    }
    if let Some(folder) = file.parent() {
        fs::create_dir_all(folder).map_err(PoseError::io(folder))?;
    }
    let mut partial = file.as_os_str().to_owned();
    partial.push(format!(".{PARTIAL}"));
    fs::write(&partial, bytes).map_err(PoseError::io(Path::new(&partial)))?;
    fs::rename(&partial, file).map_err(PoseError::io(file))
}

/// Every file under a folder that may be absent.
fn files_below(folder: &Path) -> Result<Vec<PathBuf>, PoseError> {
    let (mut files, mut open) = (Vec::new(), vec![folder.to_owned()]);
    while let Some(folder) = open.pop().filter(|folder| folder.is_dir()) {
        for entry in fs::read_dir(&folder).map_err(PoseError::io(&folder))? {
            let path = entry.map_err(PoseError::io(&folder))?.path();
            if path.is_dir() { open.push(path) } else { files.push(path) }
        }
    }
    Ok(files)
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;
    use crate::ImportLimits;
    use crate::formats::image_file::{decode, encode_png};

    /// [`Workspace::fill`], which asks whether the work is cancelled with `is_cancelled`.
    fn fill(
        into: &Path,
        photographs: &PhotosWithoutPoses,
        is_cancelled: &dyn Fn() -> bool,
    ) -> Result<Workspace, PoseError> {
        let mut ignored = |_| {};
        let run_control = RunControl::new(std::time::Duration::from_secs(600), &mut ignored, is_cancelled);
        Workspace::fill(into, photographs, &run_control)
    }

    #[test]
    fn copying_ends_between_photographs_when_cancelled() {
        let (folder, into) = (tempfile::TempDir::new().unwrap(), tempfile::TempDir::new().unwrap());
        for i in 0..9 {
            let png = encode_png(4, 3, &[[i, 120, 60]; 12]).unwrap();
            fs::write(folder.path().join(format!("{i}.png")), png).unwrap();
        }
        let photographs = PhotosWithoutPoses::open(folder.path(), &ImportLimits::default()).unwrap().unwrap();
        let calls = std::cell::Cell::new(0);
        let on_third_call = || {
            calls.set(calls.get() + 1);
            calls.get() == 3
        };
        let cancelled = fill(into.path(), &photographs, &on_third_call);
        assert!(matches!(cancelled, Err(PoseError::Cancelled)));
        assert_eq!(files_below(into.path()).unwrap().len(), 2 * GROUP);
        fill(into.path(), &photographs, &|| false).unwrap();
        assert_eq!(files_below(into.path()).unwrap().len(), 9, "the control: the next run continues");
    }

    #[test]
    fn converted_photographs_are_not_converted_again() {
        let (folder, into) = (tempfile::TempDir::new().unwrap(), tempfile::TempDir::new().unwrap());
        // The header of a picture without any picture: it cannot be converted.
        let heic = b"\0\0\0\x14ftypheic\0\0\0\0mif1";
        fs::write(folder.path().join("IMG_1.HEIC"), heic).unwrap();
        fs::write(folder.path().join("2.png"), encode_png(4, 3, &[[9u8; 3]; 12]).unwrap()).unwrap();
        let photographs = PhotosWithoutPoses::open(folder.path(), &ImportLimits::default()).unwrap().unwrap();
        let error = fill(into.path(), &photographs, &|| false).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("IMG_1.HEIC"), "the control: {error}");
        let converted = into.path().join("images/IMG_1.HEIC.jpg");
        fs::create_dir_all(converted.parent().unwrap()).unwrap();
        fs::write(&converted, "an earlier conversion").unwrap();
        fill(into.path(), &photographs, &|| false).unwrap();
        assert_eq!(fs::read(&converted).unwrap(), b"an earlier conversion");
    }

    #[test]
    #[ignore = "needs heif-enc and heif-convert (Debian: libheif-examples)"]
    fn heic_photographs_become_jpeg_files_with_their_masks() {
        let (folder, into) = (tempfile::TempDir::new().unwrap(), tempfile::TempDir::new().unwrap());
        let at = |name: &str| folder.path().join(name);
        fs::create_dir(at("masks")).unwrap();
        fs::write(at("a.png"), encode_png(64, 48, &[[200u8, 120, 60]; 64 * 48]).unwrap()).unwrap();
        // The content decides, not the name.
        for name in ["IMG_1.HEIC", "IMG_2.jpg"] {
            let made = at("x.heic");
            let status = Command::new("heif-enc").arg("-o").args([&made, &at("a.png")]).status().unwrap();
            assert!(status.success());
            fs::rename(made, at(name)).unwrap();
            let mask = encode_png(64, 48, &[[255u8]; 64 * 48]).unwrap();
            fs::write(at("masks").join(format!("{name}.png")), mask).unwrap();
        }
        let photographs = PhotosWithoutPoses::open(folder.path(), &ImportLimits::default()).unwrap().unwrap();
        assert_eq!(photographs.photos().collect::<Vec<_>>(), ["IMG_1.HEIC", "IMG_2.jpg", "a.png"]);
        let workspace = fill(into.path(), &photographs, &|| false).unwrap();
        let mut files = files_below(into.path()).unwrap();
        files.sort();
        let names = files.iter().map(|file| file.strip_prefix(into.path()).unwrap().display().to_string());
        assert_eq!(
            names.collect::<Vec<_>>(),
            [
                "images/IMG_1.HEIC.jpg",
                "images/IMG_2.jpg.jpg",
                "images/a.png",
                "masks/IMG_1.HEIC.jpg.png",
                "masks/IMG_2.jpg.jpg.png",
            ]
        );
        let bytes = fs::read(workspace.images().join("IMG_1.HEIC.jpg")).unwrap();
        let pixel = decode(&bytes, 1 << 20).unwrap().pixels[0].map(|v| v * 255.0);
        assert!(pixel.iter().zip([200.0, 120.0, 60.0]).all(|(a, b)| (a - b).abs() < 6.0), "{pixel:?}");
        assert!(bytes.starts_with(b"\xff\xd8"), "a JPEG");
        assert!(fill(into.path(), &photographs, &|| false).is_ok(), "the next run finds its files");
    }
}
