//! Read access to the files of a folder, a zip or a tar. Sizes are bounded; nothing is written to disk.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::archive::{TarCompression, TarEntries, ZipEntries, read_bounded};
use crate::formats::recognise_foreign;
use crate::{CaptureError, ImportLimits};

/// A capture's files by their path relative to the capture's root, `/` between parts.
#[derive(Debug)]
pub struct CaptureFiles {
    label: String,
    limits: ImportLimits,
    container: Container,
    /// Capture path to the container's own key.
    files: BTreeMap<String, usize>,
}

#[derive(Debug)]
enum Container {
    Folder { root: PathBuf, paths: Vec<PathBuf> },
    Zip(ZipEntries),
    Tar(TarEntries),
}

impl CaptureFiles {
    /// Opens a folder or an archive (zip, tar, gzipped tar); the kind of archive is detected from its content.
    ///
    /// A single folder around all files is removed from the paths. Files that file managers add are skipped.
    ///
    /// # Errors
    /// [`CaptureError`] when the archive is damaged, unsafe or over a limit. Links are followed in a folder, and
    /// refused in an archive.
    pub fn open(path: &Path, limits: &ImportLimits) -> Result<Self, CaptureError> {
        let label = path.file_name().map_or_else(|| path.display().to_string(), |n| n.display().to_string());
        let io = |source| CaptureError::Io { file: label.clone(), source };
        let (container, names) = if std::fs::metadata(path).map_err(io)?.is_dir() {
            let (paths, names) = files_below(path, limits)?;
            (Container::Folder { root: path.to_owned(), paths }, names)
        } else {
            open_archive(path, &label, limits)?
        };
        let files =
            names.into_iter().enumerate().filter(|(_, n)| !is_hidden_or_system(n)).map(|(i, n)| (n, i));
        let mut files: BTreeMap<String, usize> = files.collect();
        while let Some(inner) = without_outer_folder(&files) {
            files = inner;
        }
        Ok(Self { label, limits: *limits, container, files })
    }

    /// The name of the folder or archive.
    pub fn label(&self) -> &str {
        &self.label
    }

    /// The limits that [`CaptureFiles::open`] was given.
    pub fn limits(&self) -> &ImportLimits {
        &self.limits
    }

    /// True when there is a file of that path.
    pub fn contains(&self, path: &str) -> bool {
        self.files.contains_key(path)
    }

    /// Every path, sorted.
    pub fn paths(&self) -> impl Iterator<Item = &str> {
        self.files.keys().map(String::as_str)
    }

    /// The paths directly or deeper under `folder` (no trailing `/`; empty for all), sorted.
    pub fn paths_under<'a>(&'a self, folder: &'a str) -> impl Iterator<Item = &'a str> + 'a {
        let start = if folder.is_empty() { String::new() } else { format!("{folder}/") };
        let inside = self.files.range(start.clone()..).map(|(k, _)| k.as_str());
        inside.take_while(move |k| k.starts_with(&start))
    }

    /// The bytes of a file.
    ///
    /// # Errors
    /// [`CaptureError::File`] when there is none, [`CaptureError::OverLimit`] when it is too large,
    /// [`CaptureError::ArchiveDamaged`] when it does not unpack to the size and checksum that the archive states,
    /// [`CaptureError::File`] for a Git LFS pointer or a web page in its place.
    pub fn read(&self, path: &str) -> Result<Vec<u8>, CaptureError> {
        let &index = self.files.get(path).ok_or_else(|| missing(path))?;
        let bytes = match &self.container {
            Container::Folder { paths, .. } => read_file(&paths[index], path, &self.limits),
            Container::Zip(zip) => zip.read(index, path, &self.limits),
            Container::Tar(tar) => tar.read(index, path),
        }?;
        match recognise_foreign(&bytes) {
            Some(what) => Err(CaptureError::File { file: path.to_owned(), reason: what.to_owned() }),
            None => Ok(bytes),
        }
    }

    /// At most `length` bytes from the start of a file. The checksum of an archive is not checked.
    ///
    /// # Errors
    /// [`CaptureError::File`] when there is none, [`CaptureError::Io`] when it cannot be read.
    pub(super) fn read_start(&self, path: &str, length: u64) -> Result<Vec<u8>, CaptureError> {
        let &index = self.files.get(path).ok_or_else(|| missing(path))?;
        match &self.container {
            Container::Folder { paths, .. } => {
                let io = |source| CaptureError::Io { file: path.to_owned(), source };
                let mut bytes = Vec::new();
                File::open(&paths[index]).map_err(io)?.take(length).read_to_end(&mut bytes).map_err(io)?;
                Ok(bytes)
            }
            Container::Zip(zip) => zip.read_start(index, path, length),
            Container::Tar(tar) => tar.read_start(index, path, length),
        }
    }

    /// A file at a path relative to a capture folder, which may lie outside it, e.g. `../../envmaps/city.hdr`;
    /// `None` for archives.
    pub fn read_beside(&self, relative: &str) -> Option<Vec<u8>> {
        let Container::Folder { root, .. } = &self.container else { return None };
        let path = root.join(relative);
        path.is_file().then(|| read_file(&path, relative, &self.limits).ok()).flatten()
    }
}

fn missing(path: &str) -> CaptureError {
    CaptureError::File { file: path.to_owned(), reason: "is missing".to_owned() }
}

fn open_archive(
    path: &Path,
    label: &str,
    limits: &ImportLimits,
) -> Result<(Container, Vec<String>), CaptureError> {
    let io = |source| CaptureError::Io { file: label.to_owned(), source };
    let mut magic = Vec::new();
    File::open(path).map_err(io)?.take(2).read_to_end(&mut magic).map_err(io)?;
    if magic.is_empty() {
        return Err(CaptureError::ArchiveDamaged { file: label.to_owned(), reason: "is empty".to_owned() });
    }
    if magic.starts_with(b"PK") {
        let (zip, names) = ZipEntries::open(path, label, limits)?;
        return Ok((Container::Zip(zip), names));
    }
    let gzipped = magic.starts_with(&[0x1f, 0x8b]);
    let compression = if gzipped { TarCompression::Gzip } else { TarCompression::None };
    let (tar, names) = TarEntries::open(path, label, compression, limits)?;
    Ok((Container::Tar(tar), names))
}

fn read_file(path: &Path, name: &str, limits: &ImportLimits) -> Result<Vec<u8>, CaptureError> {
    let io = |source| CaptureError::Io { file: name.to_owned(), source };
    let file = File::open(path).map_err(io)?;
    read_bounded(file, limits.max_entry_bytes, name)
}

/// Every file under `root`, sorted, with its relative name. Depth is bounded, so looping links end.
fn files_below(root: &Path, limits: &ImportLimits) -> Result<(Vec<PathBuf>, Vec<String>), CaptureError> {
    const DEPTH: usize = 8;
    let mut found = BTreeMap::new();
    let mut open = vec![(root.to_owned(), String::new(), 0)];
    while let Some((folder, prefix, depth)) = open.pop() {
        let io = |source| CaptureError::Io { file: folder.display().to_string(), source };
        for entry in std::fs::read_dir(&folder).map_err(io)? {
            let entry = entry.map_err(io)?;
            let Ok(name) = entry.file_name().into_string() else { continue };
            // A link without a target is skipped.
            let Ok(meta) = std::fs::metadata(entry.path()) else { continue };
            let relative = format!("{prefix}{name}");
            if meta.is_dir() && depth < DEPTH {
                open.push((entry.path(), format!("{relative}/"), depth + 1));
            } else if meta.is_file() {
                found.insert(relative, entry.path());
            }
            if found.len() + open.len() > limits.max_entries {
                let reason = format!("more than {} files", limits.max_entries);
                return Err(CaptureError::over_limit(&root.display().to_string(), "max_entries", reason));
            }
        }
    }
    let (names, paths) = found.into_iter().unzip();
    Ok((paths, names))
}

/// True for hidden files and for those that macOS and Windows add to folders and archives.
fn is_hidden_or_system(path: &str) -> bool {
    let hidden = |part: &str| part.starts_with('.') || part == "__MACOSX";
    path.split('/').any(hidden) || path.ends_with("Thumbs.db") || path.ends_with("desktop.ini")
}

/// The paths without the folder that holds them all; `None` when there is no such folder or a layout needs it.
fn without_outer_folder(files: &BTreeMap<String, usize>) -> Option<BTreeMap<String, usize>> {
    let (outer, _) = files.keys().next()?.split_once('/')?;
    let prefix = format!("{outer}/");
    if outer == "sparse" || !files.keys().all(|k| k.starts_with(&prefix)) {
        return None;
    }
    Some(files.iter().map(|(k, &v)| (k[prefix.len()..].to_owned(), v)).collect())
}
