//! Recognises raw files of cameras. Many of them are TIFF files whose first picture is a thumbnail, which must not be taken
//! for the photograph.

/// Tags of TIFF and DNG.
const NEW_SUBFILE_TYPE: u16 = 254;
const PHOTOMETRIC: u16 = 262;
const SUB_IFDS: u16 = 330;
const DNG_VERSION: u16 = 50_706;
/// Photometric interpretations of raw data: colour filter array, linear raw.
const RAW_PHOTOMETRICS: [u32; 2] = [32_803, 34_892];
/// Position of the first directory of a CR2 file, after its own header.
const CR2_DIRECTORY: u32 = 16;
/// Greatest number of entries of a directory that are read.
const MAX_ENTRIES: usize = 1024;

/// First bytes of raw files that are no TIFF files, with the kind.
const STARTS: [(&[u8], &str); 7] = [
    (b"FUJIFILMCCD-RAW", "RAF"),
    (b"IIRO", "ORF"),
    (b"IIRS", "ORF"),
    (b"MMOR", "ORF"),
    (b"IIU\0", "RW2"),
    (b"FOVb", "X3F"),
    (b"\0MRM", "MRW"),
];

/// The kind of a raw file by its content, e.g. "DNG"; `None` for other files, also for a plain TIFF with the file extension
/// of a raw file.
pub(super) fn recognise(bytes: &[u8]) -> Option<&'static str> {
    if let Some((_, kind)) = STARTS.iter().find(|(start, _)| bytes.starts_with(start)) {
        return Some(kind);
    }
    if bytes.get(4..12) == Some(b"ftypcrx ") {
        return Some("CR3");
    }
    let tiff = Tiff::open(bytes)?;
    // The version follows the letters; a plain TIFF file may have any bytes there.
    if bytes.get(8..12) == Some(b"CR\x02\0") && tiff.long(4) == Some(CR2_DIRECTORY) {
        return Some("CR2");
    }
    let entries = tiff.first_directory();
    let value = |tag: u16| entries.iter().find(|entry| entry.0 == tag).map(|entry| entry.1);
    if value(DNG_VERSION).is_some() {
        return Some("DNG");
    }
    let is_thumbnail = value(NEW_SUBFILE_TYPE).is_some_and(|kind| kind & 1 == 1) && value(SUB_IFDS).is_some();
    let is_raw = value(PHOTOMETRIC).is_some_and(|kind| RAW_PHOTOMETRICS.contains(&kind));
    (is_thumbnail || is_raw).then_some("NEF, ARW or similar")
}

/// A TIFF file in either byte order.
struct Tiff<'a> {
    bytes: &'a [u8],
    is_little: bool,
}

impl<'a> Tiff<'a> {
    fn open(bytes: &'a [u8]) -> Option<Self> {
        let is_little = match bytes.get(..4)? {
            b"II*\0" => true,
            b"MM\0*" => false,
            _ => return None,
        };
        Some(Self { bytes, is_little })
    }

    fn short(&self, at: usize) -> Option<u16> {
        let bytes = *self.bytes.get(at..)?.first_chunk()?;
        Some(if self.is_little { u16::from_le_bytes(bytes) } else { u16::from_be_bytes(bytes) })
    }

    fn long(&self, at: usize) -> Option<u32> {
        let bytes = *self.bytes.get(at..)?.first_chunk()?;
        Some(if self.is_little { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) })
    }

    /// Tags of the first directory, each with its value as an integer of the stated size.
    fn first_directory(&self) -> Vec<(u16, u32)> {
        const SHORT: u16 = 3;
        let Some(start) = self.long(4).map(|start| start as usize) else { return Vec::new() };
        let count = usize::from(self.short(start).unwrap_or(0)).min(MAX_ENTRIES);
        let entry = |i: usize| {
            let at = start + 2 + 12 * i;
            let value = match self.short(at + 2)? {
                SHORT => u32::from(self.short(at + 8)?),
                _ => self.long(at + 8)?,
            };
            Some((self.short(at)?, value))
        };
        (0..count).map_while(entry).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A TIFF header whose first directory has these tags with long values.
    fn tiff(entries: &[(u16, u32)]) -> Vec<u8> {
        let mut out = b"II*\0\x08\0\0\0".to_vec();
        out.extend((entries.len() as u16).to_le_bytes());
        for (tag, value) in entries {
            out.extend([tag.to_le_bytes(), 4u16.to_le_bytes()].concat());
            out.extend([1u32.to_le_bytes(), value.to_le_bytes()].concat());
        }
        out
    }

    #[test]
    fn raw_files_are_recognised_by_their_content() {
        let starts =
            [&b"FUJIFILMCCD-RAW 0201"[..], b"IIRO\x08\0\0\0", b"IIU\0\x18\0\0\0", b"\0\0\0\x18ftypcrx isom"];
        for start in starts {
            assert!(recognise(start).is_some(), "{start:?}");
        }
        assert_eq!(recognise(b"II*\0\x10\0\0\0CR\x02\0"), Some("CR2"));
        let dng = tiff(&[(256, 4), (DNG_VERSION, 0x0401)]);
        assert_eq!(recognise(&dng), Some("DNG"));
        assert!(recognise(&tiff(&[(NEW_SUBFILE_TYPE, 1), (SUB_IFDS, 90)])).is_some(), "a thumbnail first");
        assert!(recognise(&tiff(&[(NEW_SUBFILE_TYPE, 0), (PHOTOMETRIC, 32_803)])).is_some(), "a mosaic");
    }

    #[test]
    fn plain_tiff_files_are_no_raw_files() {
        assert_eq!(recognise(&tiff(&[(NEW_SUBFILE_TYPE, 0), (PHOTOMETRIC, 2)])), None);
        assert_eq!(recognise(&tiff(&[(NEW_SUBFILE_TYPE, 0), (SUB_IFDS, 90)])), None, "a pyramid");
        for plain in [&b"II*\0\x40\0\0\0CR\x02\0"[..], b"II*\0\x10\0\0\0CRAB", b"II*\0\x10\0\0\0CR"] {
            assert_eq!(recognise(plain), None, "no CR2: {plain:?}");
        }
        let dng = tiff(&[(DNG_VERSION, 1)]);
        for length in 0..dng.len() {
            assert_eq!(recognise(&dng[..length]), None, "{length} bytes");
        }
    }
}
