//! The files of a zip.

use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;
use std::sync::Mutex;

use zip::ZipReadOptions;
use zip::read::{Config, OwnedZipFileEntry, ZipFileEntry};
use zip::unstable::read::ZipIterable;

use super::{
    EntryCheck, MAX_HEADER_BYTES, check_ratio, damaged, header_too_long, locked, read_bounded, safe_path,
    unreadable, unsafe_entry,
};
use crate::{CaptureError, ImportLimits};

/// The regular files of a zip, read on demand from the file on disk.
#[derive(Debug)]
pub(crate) struct ZipEntries {
    file: Mutex<BufReader<File>>,
    entries: Vec<OwnedZipFileEntry>,
}

impl ZipEntries {
    /// Reads and checks the central directory; returns the files' paths in the order of their keys.
    pub(crate) fn open(
        path: &Path,
        label: &str,
        limits: &ImportLimits,
    ) -> Result<(Self, Vec<String>), CaptureError> {
        let io = |source| CaptureError::Io { file: label.to_owned(), source };
        let file = File::open(path).map_err(io)?;
        let packed = file.metadata().map_err(io)?.len();
        let directory = BufReader::new(file.try_clone().map_err(io)?);
        let mut check = EntryCheck::new(label, limits);
        let (entries, names) = index(directory, &mut check)?;
        check_ratio(label, packed, check.total, limits)?;
        Ok((Self { file: Mutex::new(BufReader::new(file)), entries }, names))
    }

    /// Unpacks a file and checks its length and checksum against the central directory.
    pub(crate) fn read(
        &self,
        key: usize,
        name: &str,
        limits: &ImportLimits,
    ) -> Result<Vec<u8>, CaptureError> {
        let stated = self.entries[key].size();
        let bytes = self
            .unpacked(key, name, |entry| Ok(read_bounded(entry, stated.min(limits.max_entry_bytes), name)));
        let bytes = bytes?.map_err(|e| unreadable(name, "cannot be unpacked: ", &e))?;
        if bytes.len() as u64 != stated {
            return Err(damaged(name, format!("is truncated: {} of {stated} bytes", bytes.len())));
        }
        Ok(bytes)
    }

    /// At most `length` bytes from the start of an entry, without a check of its checksum.
    pub(crate) fn read_start(&self, key: usize, name: &str, length: u64) -> Result<Vec<u8>, CaptureError> {
        self.unpacked(key, name, |entry| {
            let mut bytes = Vec::new();
            let read = entry.take(length).read_to_end(&mut bytes);
            read.map(|_| bytes).map_err(|source| CaptureError::Io { file: name.to_owned(), source })
        })
    }

    /// Calls `read` with the unpacked bytes of an entry.
    fn unpacked<T>(
        &self,
        key: usize,
        name: &str,
        read: impl FnOnce(&mut dyn Read) -> Result<T, CaptureError>,
    ) -> Result<T, CaptureError> {
        let mut file = locked(&self.file);
        let entry = self.entries[key].as_ref().with_reader(&mut *file, ZipReadOptions::default());
        read(&mut entry.map_err(|e| unreadable(name, "", &e))?)
    }
}

/// The regular files of the central directory, read one header at a time.
fn index(
    directory: impl Read + Seek,
    check: &mut EntryCheck<'_>,
) -> Result<(Vec<OwnedZipFileEntry>, Vec<String>), CaptureError> {
    let label = check.label;
    let broken = |e: zip::result::ZipError| unreadable(label, "", &e);
    let mut archive = ZipIterable::try_new(directory, Config::default()).map_err(broken)?;
    let (mut entries, mut names) = (Vec::new(), Vec::new());
    let files = archive.files().map_err(broken)?;
    while let Some(entry) = files.next() {
        let entry = entry.map_err(broken)?;
        let end = files.reader_mut().stream_position();
        let end = end.map_err(|source| CaptureError::Io { file: label.to_owned(), source })?;
        let header = end.saturating_sub(entry.central_header_start());
        if header > MAX_HEADER_BYTES {
            return Err(header_too_long(&String::from_utf8_lossy(entry.name_raw()), MAX_HEADER_BYTES));
        }
        check.count(entry.name_raw().len(), memory_bytes(&entry, header))?;
        if let Some(name) = check_entry(&entry, check)? {
            entries.push(entry.into());
            names.push(name);
        }
    }
    Ok((entries, names))
}

/// Bytes of memory of an entry beside its name. Its extra fields take most of them.
fn memory_bytes(entry: &ZipFileEntry<'_>, header: u64) -> u64 {
    const FIXED_HEADER: u64 = 46;
    /// Memory of a field over its bytes in the file, at most.
    const EXTRA_FIELDS: u64 = 16;
    let texts = (entry.name_raw().len() + entry.comment().len()) as u64;
    let extra = header.saturating_sub(FIXED_HEADER + texts);
    size_of::<OwnedZipFileEntry>() as u64 + texts + EXTRA_FIELDS * extra
}

/// The path of a regular file, `None` for a folder, an error for any other kind.
fn check_entry(entry: &ZipFileEntry<'_>, check: &mut EntryCheck<'_>) -> Result<Option<String>, CaptureError> {
    let name = entry.name_raw();
    let lossy = String::from_utf8_lossy(name);
    if entry.is_dir() {
        // A folder entry creates nothing here, but an unsafe name marks a hostile archive.
        let is_root = name.iter().all(|b| matches!(b, b'.' | b'/'));
        return if is_root && !lossy.contains("..") { Ok(None) } else { safe_path(name).map(|_| None) };
    }
    const FILE_TYPE: u32 = 0o170_000;
    const REGULAR: u32 = 0o100_000;
    let kind = entry.unix_mode().map_or(0, |mode| mode & FILE_TYPE);
    if entry.is_symlink() || (kind != 0 && kind != REGULAR) {
        return Err(unsafe_entry(&lossy, "it is a link or a device, not a regular file"));
    }
    if entry.encrypted() {
        return Err(unsafe_entry(&lossy, "it is encrypted"));
    }
    let path = check.file(name, entry.size())?;
    check_ratio(&path, entry.compressed_size(), entry.size(), check.limits)?;
    Ok(Some(path))
}
