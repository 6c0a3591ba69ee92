//! Untrusted zip and tar archives: indexed once, every limit checked, entries read into memory on demand.
//!
//! Nothing is unpacked to disk, so no entry can be written outside a folder. Unsafe names are refused anyway, because
//! only an attack uses them.

use std::collections::BTreeSet;
use std::error::Error;
use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

use flate2::read::MultiGzDecoder;

use crate::{CaptureError, ImportLimits};

/// Entries up to this size may have any compression ratio: all-black images and tables of zeros have high ones.
const RATIO_FREE_BYTES: u64 = 1 << 20;
/// Longest path of an entry, bytes.
const MAX_NAME_BYTES: usize = 1024;

fn damaged(file: &str, reason: impl std::fmt::Display) -> CaptureError {
    CaptureError::ArchiveDamaged { file: file.to_owned(), reason: reason.to_string() }
}

/// The operating system's error below `error`, if there is one. A seek out of range (`InvalidInput`) is a fault of
/// the archive and gives `None`.
fn of_disk(error: &(dyn Error + 'static)) -> Option<std::io::Error> {
    let mut next = Some(error);
    while let Some(error) = next {
        let told = error.downcast_ref::<std::io::Error>().and_then(std::io::Error::raw_os_error);
        if let Some(code) = told {
            let found = std::io::Error::from_raw_os_error(code);
            return (found.kind() != std::io::ErrorKind::InvalidInput).then_some(found);
        }
        next = error.source();
    }
    None
}

/// The error for an archive that cannot be read: [`CaptureError::Io`] if the disk failed, else
/// [`CaptureError::ArchiveDamaged`].
fn unreadable(file: &str, says: &str, error: &(dyn Error + 'static)) -> CaptureError {
    match of_disk(error) {
        Some(source) => CaptureError::Io { file: file.to_owned(), source },
        None => damaged(file, format!("{says}{error}")),
    }
}

fn unsafe_entry(file: &str, reason: &str) -> CaptureError {
    CaptureError::UnsafeEntry { file: file.to_owned(), reason: reason.to_owned() }
}

/// Checks the entries that an archive declares, one by one, against the limits.
struct EntryCheck<'a> {
    label: &'a str,
    limits: &'a ImportLimits,
    entries: usize,
    total: u64,
    names: BTreeSet<String>,
}

impl<'a> EntryCheck<'a> {
    fn new(label: &'a str, limits: &'a ImportLimits) -> Self {
        Self { label, limits, entries: 0, total: 0, names: BTreeSet::new() }
    }

    /// Counts an entry of any type.
    fn count(&mut self) -> Result<(), CaptureError> {
        self.entries += 1;
        if self.entries > self.limits.max_entries {
            let reason = format!("more than {} entries", self.limits.max_entries);
            return Err(CaptureError::over_limit(self.label, "max_entries", reason));
        }
        Ok(())
    }

    /// Counts a regular file; returns its checked, normalised path.
    fn file(&mut self, raw_name: &[u8], size: u64) -> Result<String, CaptureError> {
        let path = safe_path(raw_name)?;
        if size > self.limits.max_entry_bytes {
            let reason = format!("{size} bytes, {} allowed", self.limits.max_entry_bytes);
            return Err(CaptureError::over_limit(&path, "max_entry_bytes", reason));
        }
        self.total = self.total.saturating_add(size);
        if self.total > self.limits.max_total_bytes {
            let reason = format!("unpacks to more than {} bytes", self.limits.max_total_bytes);
            return Err(CaptureError::over_limit(self.label, "max_total_bytes", reason));
        }
        if !self.names.insert(path.clone()) {
            return Err(unsafe_entry(&path, "the archive contains this path twice"));
        }
        Ok(path)
    }
}

/// An entry's name as a relative path without `.`, `..` and empty parts.
fn safe_path(raw: &[u8]) -> Result<String, CaptureError> {
    let lossy = String::from_utf8_lossy(raw);
    let refuse = |reason: &str| Err(unsafe_entry(&lossy, reason));
    let Ok(name) = std::str::from_utf8(raw) else { return refuse("its name is not UTF-8") };
    if name.len() > MAX_NAME_BYTES {
        return refuse("its name is longer than 1024 bytes");
    }
    if name.contains(['\\', '\0', ':']) {
        return refuse("its name contains a backslash, a colon or a NUL");
    }
    if name.starts_with('/') {
        return refuse("its path is absolute");
    }
    let parts: Vec<&str> = name.split('/').filter(|p| !p.is_empty() && *p != ".").collect();
    if parts.contains(&"..") {
        return refuse("its path leads out of the archive");
    }
    if parts.is_empty() {
        return refuse("it has no name");
    }
    Ok(parts.join("/"))
}

/// All bytes of `reader`.
///
/// # Errors
/// [`CaptureError::OverLimit`] beyond `limit` bytes.
pub(super) fn read_bounded(reader: impl Read, limit: u64, name: &str) -> Result<Vec<u8>, CaptureError> {
    let mut bytes = Vec::new();
    let damaged = |source| CaptureError::Io { file: name.to_owned(), source };
    reader.take(limit.saturating_add(1)).read_to_end(&mut bytes).map_err(damaged)?;
    if bytes.len() as u64 > limit {
        let reason = format!("more than {limit} bytes");
        return Err(CaptureError::over_limit(name, "max_entry_bytes", reason));
    }
    Ok(bytes)
}

fn check_ratio(file: &str, packed: u64, unpacked: u64, limits: &ImportLimits) -> Result<(), CaptureError> {
    if unpacked > RATIO_FREE_BYTES && unpacked / packed.max(1) >= limits.max_ratio {
        let reason = format!("{packed} bytes are declared to unpack to {unpacked}");
        return Err(CaptureError::over_limit(file, "max_ratio", reason));
    }
    Ok(())
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A thread that panicked can only have moved the file position, and every read seeks first.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The regular files of a zip, read on demand from the file on disk.
#[derive(Debug)]
pub(super) struct ZipEntries {
    archive: Mutex<zip::ZipArchive<BufReader<File>>>,
    /// Index in the archive of each listed file.
    indices: Vec<usize>,
}

impl ZipEntries {
    /// Reads and checks the central directory; returns the files' paths in the order of their keys.
    pub(super) fn open(
        path: &Path,
        label: &str,
        limits: &ImportLimits,
    ) -> Result<(Self, Vec<String>), CaptureError> {
        let io = |source| CaptureError::Io { file: label.to_owned(), source };
        let file = File::open(path).map_err(io)?;
        let packed = file.metadata().map_err(io)?.len();
        let mut archive =
            zip::ZipArchive::new(BufReader::new(file)).map_err(|e| unreadable(label, "", &e))?;
        if archive.has_duplicate_names() {
            return Err(unsafe_entry(label, "the archive contains a path twice"));
        }
        let mut check = EntryCheck::new(label, limits);
        let (mut indices, mut names) = (Vec::new(), Vec::new());
        for index in 0..archive.len() {
            let entry = archive.by_index_raw(index).map_err(|e| unreadable(label, "", &e))?;
            check.count()?;
            if let Some(name) = check_zip_entry(&entry, &mut check)? {
                indices.push(index);
                names.push(name);
            }
        }
        check_ratio(label, packed, check.total, limits)?;
        Ok((Self { archive: Mutex::new(archive), indices }, names))
    }

    /// Unpacks a file and checks its length and checksum against the central directory.
    pub(super) fn read(
        &self,
        key: usize,
        name: &str,
        limits: &ImportLimits,
    ) -> Result<Vec<u8>, CaptureError> {
        let mut archive = locked(&self.archive);
        let entry = archive.by_index(self.indices[key]).map_err(|e| unreadable(name, "", &e))?;
        let stated = entry.size();
        let bytes = read_bounded(entry, stated.min(limits.max_entry_bytes), name);
        let bytes = bytes.map_err(|e| unreadable(name, "cannot be unpacked: ", &e))?;
        if bytes.len() as u64 != stated {
            return Err(damaged(name, format!("is truncated: {} of {stated} bytes", bytes.len())));
        }
        Ok(bytes)
    }

    /// At most `length` bytes from the start of an entry, without a check of its checksum.
    pub(super) fn read_start(&self, key: usize, name: &str, length: u64) -> Result<Vec<u8>, CaptureError> {
        let mut archive = locked(&self.archive);
        let entry = archive.by_index(self.indices[key]).map_err(|e| unreadable(name, "", &e))?;
        let mut bytes = Vec::new();
        let read = entry.take(length).read_to_end(&mut bytes);
        read.map_err(|source| CaptureError::Io { file: name.to_owned(), source })?;
        Ok(bytes)
    }
}

/// The path of a regular file, `None` for a folder, an error for any other kind.
fn check_zip_entry<R: Read + ?Sized>(
    entry: &zip::read::ZipFile<'_, R>,
    check: &mut EntryCheck<'_>,
) -> Result<Option<String>, CaptureError> {
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

/// How a tar is compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TarCompression {
    None,
    Gzip,
}

/// The regular files of a tar. An uncompressed tar stays on disk; a compressed tar is held in memory.
#[derive(Debug)]
pub(super) struct TarEntries {
    backing: Backing,
    /// Offset and length of each listed file, bytes.
    spans: Vec<(u64, u64)>,
}

#[derive(Debug)]
enum Backing {
    File(Mutex<File>),
    Memory(Vec<u8>),
}

impl TarEntries {
    /// Reads and checks all headers; returns the files' paths in the order of their keys.
    pub(super) fn open(
        path: &Path,
        label: &str,
        compression: TarCompression,
        limits: &ImportLimits,
    ) -> Result<(Self, Vec<String>), CaptureError> {
        let io = |source| CaptureError::Io { file: label.to_owned(), source };
        let mut file = File::open(path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        if compression == TarCompression::Gzip {
            let bytes = gunzip(file, length, label, limits)?;
            let (spans, names) = index_tar(Cursor::new(&bytes), bytes.len() as u64, label, limits)?;
            return Ok((Self { backing: Backing::Memory(bytes), spans }, names));
        }
        let (spans, names) = index_tar(BufReader::new(&mut file), length, label, limits)?;
        Ok((Self { backing: Backing::File(Mutex::new(file)), spans }, names))
    }

    /// Bytes of memory that the open archive takes, without its index.
    pub(super) fn held_bytes(&self) -> u64 {
        match &self.backing {
            Backing::Memory(bytes) => bytes.len() as u64,
            Backing::File(_) => 0,
        }
    }

    /// The bytes of a file.
    pub(super) fn read(&self, key: usize, name: &str) -> Result<Vec<u8>, CaptureError> {
        self.read_start(key, name, u64::MAX)
    }

    /// At most `length` bytes from the start of an entry.
    pub(super) fn read_start(&self, key: usize, name: &str, length: u64) -> Result<Vec<u8>, CaptureError> {
        let (start, stored) = self.spans[key];
        let length = length.min(stored);
        match &self.backing {
            // The spans were checked against the length when the index was made.
            Backing::Memory(bytes) => Ok(bytes[start as usize..(start + length) as usize].to_vec()),
            Backing::File(file) => {
                let mut file = locked(file);
                let io = |source| CaptureError::Io { file: name.to_owned(), source };
                file.seek(SeekFrom::Start(start)).map_err(io)?;
                let mut bytes = vec![0; length as usize];
                file.read_exact(&mut bytes).map_err(io)?;
                Ok(bytes)
            }
        }
    }
}

fn gunzip(file: File, packed: u64, label: &str, limits: &ImportLimits) -> Result<Vec<u8>, CaptureError> {
    let by_ratio = packed.saturating_mul(limits.max_ratio).max(RATIO_FREE_BYTES);
    let (limit, name) = if by_ratio < limits.max_gzip_bytes {
        (by_ratio, "max_ratio")
    } else {
        (limits.max_gzip_bytes, "max_gzip_bytes")
    };
    let mut bytes = Vec::new();
    let decoder = MultiGzDecoder::new(BufReader::new(file));
    decoder.take(limit + 1).read_to_end(&mut bytes).map_err(|e| unreadable(label, "", &e))?;
    if bytes.len() as u64 > limit {
        return Err(CaptureError::over_limit(
            label,
            name,
            format!("{packed} bytes unpack to more than {limit} bytes"),
        ));
    }
    Ok(bytes)
}

/// The text of `error` without the invalid header bytes that it repeats.
fn without_bytes(error: &std::io::Error) -> String {
    let text = error.to_string();
    let end = text.find(':').into_iter().chain(text.find(" when getting ")).min();
    text[..end.unwrap_or(text.len())].to_owned()
}

type TarIndex = (Vec<(u64, u64)>, Vec<String>);

fn index_tar(
    reader: impl Read + Seek,
    length: u64,
    label: &str,
    limits: &ImportLimits,
) -> Result<TarIndex, CaptureError> {
    let mut check = EntryCheck::new(label, limits);
    let (mut spans, mut names) = (Vec::new(), Vec::new());
    let mut end = 0;
    let mut archive = tar::Archive::new(reader);
    let not_tar = |e: std::io::Error| match of_disk(&e) {
        Some(_) => unreadable(label, "", &e),
        None => damaged(label, format!("not a readable zip, tar or tar.gz: {}", without_bytes(&e))),
    };
    for entry in archive.entries_with_seek().map_err(not_tar)? {
        let entry = entry.map_err(not_tar)?;
        check.count()?;
        let kind = entry.header().entry_type();
        let name = entry.path_bytes();
        let (start, size) = (entry.raw_file_position(), entry.size());
        end = start.saturating_add(size);
        if end > length {
            return Err(damaged(&String::from_utf8_lossy(&name), "is truncated: the archive ends inside it"));
        }
        if kind.is_pax_global_extensions() {
            continue;
        }
        if kind.is_dir() {
            if !name.iter().all(|b| matches!(b, b'.' | b'/')) {
                safe_path(&name)?;
            }
            continue;
        }
        if !(kind.is_file() || kind.is_contiguous()) {
            let reason = "it is a link, a device or a sparse file, not a regular file";
            return Err(unsafe_entry(&String::from_utf8_lossy(&name), reason));
        }
        names.push(check.file(&name, size)?);
        spans.push((start, size));
    }
    // A complete tar ends in blocks of zeros; a tar that is truncated between two entries does not.
    if length < end.next_multiple_of(512).saturating_add(512) {
        return Err(damaged(label, "is truncated: the blocks that end an archive are missing"));
    }
    Ok((spans, names))
}
