//! One view of a folder, a zip or a tar: names in, bounded bytes out. Nothing is ever written to disk.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::capture::archive::{TarEntries, ZipEntries};
use crate::capture::{CaptureError, Limits};

/// A capture's files by their path relative to the capture's root, `/` between parts.
#[derive(Debug)]
pub struct Source {
    label: String,
    limits: Limits,
    store: Store,
    /// Capture path to the store's own key.
    files: BTreeMap<String, usize>,
}

#[derive(Debug)]
enum Store {
    Folder { root: PathBuf, paths: Vec<PathBuf> },
    Zip(ZipEntries),
    Tar(TarEntries),
}

impl Source {
    /// Opens a folder, or an archive told by its content (zip, tar, gzipped tar).
    ///
    /// A single folder around everything is looked through, and the litter of file managers is left out.
    ///
    /// # Errors
    /// [`CaptureError`] when the archive is damaged, unsafe or over a limit. A folder is trusted further than
    /// an archive: links in it are followed.
    pub fn open(path: &Path, limits: &Limits) -> Result<Self, CaptureError> {
        let label = path.file_name().map_or_else(|| path.display().to_string(), |n| n.display().to_string());
        let io = |source| CaptureError::Io { file: label.clone(), source };
        let (store, names) = if std::fs::metadata(path).map_err(io)?.is_dir() {
            let (paths, names) = walk(path, limits)?;
            (Store::Folder { root: path.to_owned(), paths }, names)
        } else {
            open_archive(path, &label, limits)?
        };
        let files = names.into_iter().enumerate().filter(|(_, n)| !is_litter(n)).map(|(i, n)| (n, i));
        let mut files: BTreeMap<String, usize> = files.collect();
        while let Some(inner) = without_wrapper(&files) {
            files = inner;
        }
        Ok(Self { label, limits: *limits, store, files })
    }

    /// The name of the folder or archive.
    pub fn label(&self) -> &str {
        &self.label
    }

    /// The limits it was opened with.
    pub fn limits(&self) -> &Limits {
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
    /// [`CaptureError::ArchiveDamaged`] when it does not unpack to what the archive promised.
    pub fn read(&self, path: &str) -> Result<Vec<u8>, CaptureError> {
        let missing = || CaptureError::File { file: path.to_owned(), reason: "is missing".to_owned() };
        let &index = self.files.get(path).ok_or_else(missing)?;
        match &self.store {
            Store::Folder { paths, .. } => read_file(&paths[index], path, &self.limits),
            Store::Zip(zip) => zip.read(index, path, &self.limits),
            Store::Tar(tar) => tar.read(index, path),
        }
    }

    /// A file found at `relative` to a capture *folder*, perhaps outside it, e.g. `../../envmaps/city.hdr`.
    /// Archives have no outside.
    pub fn read_beside(&self, relative: &str) -> Option<Vec<u8>> {
        let Store::Folder { root, .. } = &self.store else { return None };
        let path = root.join(relative);
        path.is_file().then(|| read_file(&path, relative, &self.limits).ok()).flatten()
    }
}

fn open_archive(path: &Path, label: &str, limits: &Limits) -> Result<(Store, Vec<String>), CaptureError> {
    let io = |source| CaptureError::Io { file: label.to_owned(), source };
    let mut magic = [0u8; 4];
    let mut file = File::open(path).map_err(io)?;
    let mut filled = 0;
    while filled < magic.len() {
        match file.read(&mut magic[filled..]).map_err(io)? {
            0 => break,
            n => filled += n,
        }
    }
    if filled == 0 {
        return Err(CaptureError::ArchiveDamaged { file: label.to_owned(), reason: "is empty".to_owned() });
    }
    if magic.starts_with(b"PK") {
        let (zip, names) = ZipEntries::open(path, label, limits)?;
        return Ok((Store::Zip(zip), names));
    }
    let gzipped = magic.starts_with(&[0x1f, 0x8b]);
    let (tar, names) = TarEntries::open(path, label, gzipped, limits)?;
    Ok((Store::Tar(tar), names))
}

fn read_file(path: &Path, name: &str, limits: &Limits) -> Result<Vec<u8>, CaptureError> {
    let io = |source| CaptureError::Io { file: name.to_owned(), source };
    let file = File::open(path).map_err(io)?;
    read_bounded(file, limits.max_entry_bytes, name)
}

/// Everything `reader` has, refused beyond `limit` bytes.
pub(super) fn read_bounded(reader: impl Read, limit: u64, name: &str) -> Result<Vec<u8>, CaptureError> {
    let mut bytes = Vec::new();
    let damaged = |source| CaptureError::Io { file: name.to_owned(), source };
    reader.take(limit.saturating_add(1)).read_to_end(&mut bytes).map_err(damaged)?;
    if bytes.len() as u64 > limit {
        let reason = format!("more than {limit} bytes");
        return Err(CaptureError::OverLimit { file: name.to_owned(), limit: "max_entry_bytes", reason });
    }
    Ok(bytes)
}

/// Every file under `root`, sorted, with its relative name. Depth is bounded, so looping links end.
fn walk(root: &Path, limits: &Limits) -> Result<(Vec<PathBuf>, Vec<String>), CaptureError> {
    const DEPTH: usize = 8;
    let mut found = BTreeMap::new();
    let mut open = vec![(root.to_owned(), String::new(), 0)];
    while let Some((folder, prefix, depth)) = open.pop() {
        let io = |source| CaptureError::Io { file: folder.display().to_string(), source };
        for entry in std::fs::read_dir(&folder).map_err(io)? {
            let entry = entry.map_err(io)?;
            let Ok(name) = entry.file_name().into_string() else { continue };
            // A dangling link is nobody's file.
            let Ok(meta) = std::fs::metadata(entry.path()) else { continue };
            let relative = format!("{prefix}{name}");
            if meta.is_dir() && depth < DEPTH {
                open.push((entry.path(), format!("{relative}/"), depth + 1));
            } else if meta.is_file() {
                found.insert(relative, entry.path());
            }
            if found.len() + open.len() > limits.max_entries {
                let reason = format!("more than {} files", limits.max_entries);
                let file = root.display().to_string();
                return Err(CaptureError::OverLimit { file, limit: "max_entries", reason });
            }
        }
    }
    let (names, paths) = found.into_iter().unzip();
    Ok((paths, names))
}

/// What macOS and Windows leave in archives and folders, and anything hidden.
fn is_litter(path: &str) -> bool {
    let hidden = |part: &str| part.starts_with('.') || part == "__MACOSX";
    path.split('/').any(hidden) || path.ends_with("Thumbs.db") || path.ends_with("desktop.ini")
}

/// The files without the one folder that holds them all, if there is such a folder and it is no layout's own.
fn without_wrapper(files: &BTreeMap<String, usize>) -> Option<BTreeMap<String, usize>> {
    let (wrapper, _) = files.keys().next()?.split_once('/')?;
    let prefix = format!("{wrapper}/");
    if wrapper == "sparse" || !files.keys().all(|k| k.starts_with(&prefix)) {
        return None;
    }
    Some(files.iter().map(|(k, &v)| (k[prefix.len()..].to_owned(), v)).collect())
}
