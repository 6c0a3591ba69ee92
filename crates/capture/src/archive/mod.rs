//! Untrusted zip and tar archives: indexed once, every limit checked, entries read into memory on demand.
//!
//! No entry becomes a file, so none can be written outside a folder. Unsafe names are refused anyway, because only an
//! attack uses them. The size of a name or header is checked before it is read.

mod tar_entries;
mod zip_entries;

use std::collections::BTreeSet;
use std::error::Error;
use std::io::Read;
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::text::shown;
use crate::{CaptureError, ImportLimits};

pub(super) use tar_entries::{TarCompression, TarEntries};
pub(super) use zip_entries::ZipEntries;

/// Entries up to this size may have any compression ratio: all-black images and tables of zeros have high ones.
const RATIO_FREE_BYTES: u64 = 1 << 20;
/// Longest path of an entry, bytes.
const MAX_NAME_BYTES: usize = 1024;
/// Longest header of an entry of a zip, and longest field with a name in a tar, bytes. Larger ones are not read.
const MAX_HEADER_BYTES: u64 = 4096;

fn damaged(file: &str, reason: impl std::fmt::Display) -> CaptureError {
    CaptureError::ArchiveDamaged { file: shown(file), reason: reason.to_string() }
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
    CaptureError::UnsafeEntry { file: shown(file), reason: reason.to_owned() }
}

/// The refusal of an entry whose name or header takes more than `limit` bytes.
fn header_too_long(file: &str, limit: u64) -> CaptureError {
    let reason =
        format!("its name or header is longer than {limit} bytes; give files and folders shorter names");
    unsafe_entry(file, &reason)
}

/// Checks the entries that an archive declares, one by one, against the limits.
struct EntryCheck<'a> {
    label: &'a str,
    limits: &'a ImportLimits,
    entries: usize,
    total: u64,
    header_bytes: u64,
    names: BTreeSet<String>,
}

impl<'a> EntryCheck<'a> {
    fn new(label: &'a str, limits: &'a ImportLimits) -> Self {
        Self { label, limits, entries: 0, total: 0, header_bytes: 0, names: BTreeSet::new() }
    }

    /// Counts an entry of any type with a name of `name_bytes`, whose header takes `header_bytes` of memory.
    fn count(&mut self, name_bytes: usize, header_bytes: u64) -> Result<(), CaptureError> {
        /// Lists that contain the name while a capture is opened, and the bytes of an item of them.
        const LISTS: u64 = 3;
        const ITEM: u64 = 48;
        self.entries += 1;
        let memory = LISTS * (name_bytes as u64 + ITEM) + header_bytes;
        self.header_bytes = self.header_bytes.saturating_add(memory);
        if self.header_bytes > self.limits.max_header_bytes {
            let reason = format!(
                "the names and headers of its entries take more than {} bytes of memory; give files and folders shorter names",
                self.limits.max_header_bytes
            );
            return Err(CaptureError::over_limit(self.label, "max_header_bytes", reason));
        }
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
///
/// # Errors
/// [`CaptureError::UnsafeEntry`].
fn safe_path(raw: &[u8]) -> Result<String, CaptureError> {
    let lossy = String::from_utf8_lossy(raw);
    let refuse = |reason: &str| Err(unsafe_entry(&lossy, reason));
    let Ok(name) = std::str::from_utf8(raw) else { return refuse("its name is not UTF-8") };
    if name.len() > MAX_NAME_BYTES {
        return refuse("its name is longer than 1024 bytes; give files and folders shorter names");
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
