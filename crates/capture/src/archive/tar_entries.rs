//! The files of a tar.
//!
//! The headers are read one by one without the interpretation of the `tar` crate, which reads long names, pax headers
//! and the maps of sparse files into memory whatever their size.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Mutex;

use flate2::read::MultiGzDecoder;
use tar::{Entry, EntryType, PaxExtensions};

use super::{
    EntryCheck, MAX_HEADER_BYTES, RATIO_FREE_BYTES, damaged, header_too_long, locked, of_disk, safe_path,
    unreadable, unsafe_entry,
};
use crate::text::shown;
use crate::{CaptureError, ImportLimits};

/// Longest pax header of an entry, bytes. It also has the extended attributes of a file.
const MAX_PAX_BYTES: u64 = 64 << 10;

/// How a tar is compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum TarCompression {
    None,
    Gzip,
}

/// The regular files of a tar, read on demand from the file on disk.
#[derive(Debug)]
pub(crate) struct TarEntries {
    file: Mutex<File>,
    /// Offset and length of each listed file, bytes.
    spans: Vec<(u64, u64)>,
}

impl TarEntries {
    /// Reads and checks all headers; returns the files' paths in the order of their keys. A compressed tar is unpacked
    /// to a file without a name, which the system removes when it is closed.
    pub(crate) fn open(
        path: &Path,
        label: &str,
        compression: TarCompression,
        limits: &ImportLimits,
    ) -> Result<(Self, Vec<String>), CaptureError> {
        let io = |source| CaptureError::Io { file: label.to_owned(), source };
        let mut file = File::open(path).map_err(io)?;
        if compression == TarCompression::Gzip {
            let packed = file.metadata().map_err(io)?.len();
            file = gunzip(file, packed, path, label, limits)?;
        }
        let length = file.metadata().map_err(io)?.len();
        file.seek(SeekFrom::Start(0)).map_err(io)?;
        let (spans, names) = Index::of(BufReader::new(&mut file), length, label, limits)?;
        Ok((Self { file: Mutex::new(file), spans }, names))
    }

    /// The bytes of a file.
    pub(crate) fn read(&self, key: usize, name: &str) -> Result<Vec<u8>, CaptureError> {
        self.read_start(key, name, u64::MAX)
    }

    /// At most `length` bytes from the start of an entry.
    pub(crate) fn read_start(&self, key: usize, name: &str, length: u64) -> Result<Vec<u8>, CaptureError> {
        let (start, stored) = self.spans[key];
        let mut file = locked(&self.file);
        let io = |source| CaptureError::Io { file: name.to_owned(), source };
        file.seek(SeekFrom::Start(start)).map_err(io)?;
        // The spans were checked against the length when the index was made.
        let mut bytes = vec![0; length.min(stored) as usize];
        file.read_exact(&mut bytes).map_err(io)?;
        Ok(bytes)
    }
}

/// The unpacked file, beside the archive or, if its folder cannot be written, in the folder for temporary files.
fn gunzip(
    file: File,
    packed: u64,
    path: &Path,
    label: &str,
    limits: &ImportLimits,
) -> Result<File, CaptureError> {
    let by_ratio = packed.saturating_mul(limits.max_ratio).max(RATIO_FREE_BYTES);
    let (limit, name) = if by_ratio < limits.max_gzip_bytes {
        (by_ratio, "max_ratio")
    } else {
        (limits.max_gzip_bytes, "max_gzip_bytes")
    };
    let beside = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let unpacked = tempfile::tempfile_in(beside).or_else(|_| tempfile::tempfile());
    let io = |source| CaptureError::Io { file: label.to_owned(), source };
    let mut unpacked = unpacked.map_err(io)?;
    let mut decoder = MultiGzDecoder::new(BufReader::new(file)).take(limit + 1);
    let length = std::io::copy(&mut decoder, &mut unpacked).map_err(|e| unreadable(label, "", &e))?;
    if length > limit {
        let reason = format!("{packed} bytes unpack to more than {limit} bytes");
        return Err(CaptureError::over_limit(label, name, reason));
    }
    Ok(unpacked)
}

/// The text of `error` without the invalid header bytes that it repeats.
fn without_bytes(error: &std::io::Error) -> String {
    let text = error.to_string();
    let end = text.find(':').into_iter().chain(text.find(" when getting ")).min();
    text[..end.unwrap_or(text.len())].to_owned()
}

/// What the headers before an entry state about it.
#[derive(Default)]
struct Extensions {
    /// The name of a GNU header.
    gnu_name: Option<Vec<u8>>,
    pax: Option<Vec<u8>>,
    has_gnu_link: bool,
}

impl Extensions {
    fn is_empty(&self) -> bool {
        self.gnu_name.is_none() && self.pax.is_none() && !self.has_gnu_link
    }

    /// The value of a pax field. Of several the last is valid.
    fn pax_value(&self, key: &str) -> Option<&[u8]> {
        let fields = PaxExtensions::new(self.pax.as_deref()?).filter_map(Result::ok);
        fields.filter(|field| field.key() == Ok(key)).last().map(|field| field.value_bytes())
    }

    /// The name of the entry whose own header has `short`.
    fn name(&self, short: &[u8]) -> Vec<u8> {
        match (&self.gnu_name, self.pax_value("path")) {
            (Some(name), _) => name.strip_suffix(&[0]).unwrap_or(name).to_vec(),
            (None, Some(name)) => name.to_vec(),
            (None, None) => short.to_vec(),
        }
    }
}

type TarIndex = (Vec<(u64, u64)>, Vec<String>);

/// The index of a tar while its headers are read.
struct Index<'a> {
    check: EntryCheck<'a>,
    length: u64,
    /// The end of the last entry.
    end: u64,
    extensions: Extensions,
    spans: Vec<(u64, u64)>,
    names: Vec<String>,
}

impl<'a> Index<'a> {
    fn of(
        reader: impl Read + Seek,
        length: u64,
        label: &'a str,
        limits: &'a ImportLimits,
    ) -> Result<TarIndex, CaptureError> {
        let check = EntryCheck::new(label, limits);
        let extensions = Extensions::default();
        let mut index = Self { check, length, end: 0, extensions, spans: Vec::new(), names: Vec::new() };
        let mut archive = tar::Archive::new(reader);
        let entries = archive.entries_with_seek().map_err(|e| not_tar(label, &e))?.raw(true);
        for entry in entries {
            index.add(entry.map_err(|e| not_tar(label, &e))?)?;
        }
        // A complete tar ends in blocks of zeros; a tar that is truncated between two entries does not.
        if !index.extensions.is_empty() || length < index.end.next_multiple_of(512).saturating_add(512) {
            return Err(damaged(label, "is truncated: the blocks that end an archive are missing"));
        }
        Ok((index.spans, index.names))
    }

    fn add(&mut self, mut entry: Entry<'_, impl Read>) -> Result<(), CaptureError> {
        let (kind, size) = (entry.header().entry_type(), entry.size());
        let start = entry.raw_file_position();
        self.end = start.saturating_add(size);
        if self.end > self.length {
            let name = self.extensions.name(&entry.path_bytes());
            let name = String::from_utf8_lossy(&name);
            return Err(damaged(&name, "is truncated: the archive ends inside it"));
        }
        match kind {
            EntryType::GNULongName | EntryType::GNULongLink | EntryType::XHeader => {
                self.extend(&mut entry, kind, size)
            }
            EntryType::XGlobalHeader => self.check.count(0, 0),
            _ => self.member(&entry, kind, (start, size)),
        }
    }

    /// Reads a header that describes the next entry.
    fn extend(
        &mut self,
        entry: &mut Entry<'_, impl Read>,
        kind: EntryType,
        size: u64,
    ) -> Result<(), CaptureError> {
        let label = self.check.label;
        let limit = if kind == EntryType::XHeader { MAX_PAX_BYTES } else { MAX_HEADER_BYTES };
        if size > limit {
            return Err(header_too_long(label, limit));
        }
        let mut bytes = Vec::new();
        entry.read_to_end(&mut bytes).map_err(|e| not_tar(label, &e))?;
        let stated_before = match kind {
            EntryType::GNULongName => self.extensions.gnu_name.replace(bytes).is_some(),
            EntryType::XHeader => self.extensions.pax.replace(bytes).is_some(),
            _ => std::mem::replace(&mut self.extensions.has_gnu_link, true),
        };
        if stated_before {
            return Err(damaged(label, "two headers describe the same entry"));
        }
        Ok(())
    }

    /// Adds an entry that the headers before it describe.
    fn member(
        &mut self,
        entry: &Entry<'_, impl Read>,
        kind: EntryType,
        (start, size): (u64, u64),
    ) -> Result<(), CaptureError> {
        let extensions = std::mem::take(&mut self.extensions);
        let name = extensions.name(&entry.path_bytes());
        let lossy = String::from_utf8_lossy(&name);
        self.check.count(name.len(), size_of::<(u64, u64)>() as u64)?;
        if let Some(stated) = extensions.pax_value("size")
            && stated != size.to_string().as_bytes()
        {
            // Programs disagree which of the two is valid. Only files beyond 8 GiB need the second.
            let stated = shown(&String::from_utf8_lossy(stated));
            return Err(unsafe_entry(
                &lossy,
                &format!("its headers state two sizes, {size} and {stated} bytes"),
            ));
        }
        if kind.is_dir() {
            if !name.iter().all(|b| matches!(b, b'.' | b'/')) {
                safe_path(&name)?;
            }
            return Ok(());
        }
        if !(kind.is_file() || kind.is_contiguous()) {
            let reason = "it is a link, a device or a sparse file, not a regular file";
            return Err(unsafe_entry(&lossy, reason));
        }
        self.names.push(self.check.file(&name, size)?);
        self.spans.push((start, size));
        Ok(())
    }
}

fn not_tar(label: &str, error: &std::io::Error) -> CaptureError {
    match of_disk(error) {
        Some(_) => unreadable(label, "", error),
        None => damaged(label, format!("not a readable zip, tar or tar.gz: {}", without_bytes(error))),
    }
}
