//! The containers of SPZ files: one gzip stream (versions 2 and 3), or a header, a table of contents and a Zstandard
//! stream for each block (version 4).

use std::io::Read;

use flate2::read::GzDecoder;
use ruzstd::decoding::StreamingDecoder;

use crate::formats::ply_table::{PlyError, bad};
use relume_scene::sh_count;

const MAGIC: &[u8] = b"NGSP";
const GZIP: &[u8] = &[0x1f, 0x8b];
/// Bytes of the header of versions 2 and 3, and of version 4.
const SHORT_HEADER: usize = 16;
const LONG_HEADER: usize = 32;
/// Highest SH degree of the format.
const MAX_DEGREE: u8 = 4;
/// Greatest number of splats; a file of this size unpacks to 1.5 GB.
const MAX_SPLATS: u32 = 16 << 20;
/// Bits of the field `flags`.
const ANTIALIASED: u8 = 1;
const EXTENSIONS: u8 = 2;

/// The unpacked blocks of a file. Their lengths fit `count` and `degree`.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct SpzBlocks {
    pub count: usize,
    /// SH degree, 0 to 4.
    pub degree: usize,
    /// Bits after the point of positions, 0 to 24.
    pub fractional_bits: u8,
    /// True if the splats were trained with the low-pass compensation of Mip-Splatting.
    pub is_antialiased: bool,
    pub has_extensions: bool,
    /// 3 in version 2, later 4.
    pub rotation_bytes: usize,
    pub positions: Vec<u8>,
    pub opacities: Vec<u8>,
    pub colours: Vec<u8>,
    pub scales: Vec<u8>,
    pub rotations: Vec<u8>,
    pub harmonics: Vec<u8>,
}

/// Fields of the header.
struct SpzHeader {
    version: u32,
    count: usize,
    degree: usize,
    fractional_bits: u8,
    flags: u8,
}

impl SpzHeader {
    fn read(bytes: &[u8]) -> Result<Self, PlyError> {
        let Some(header) = bytes.first_chunk::<SHORT_HEADER>() else { return bad("header", "is truncated") };
        if !header.starts_with(MAGIC) {
            return bad("header", "is not that of an SPZ file");
        }
        let number = |at: usize| u32::from_le_bytes(std::array::from_fn(|k| header[at + k]));
        let (version, count) = (number(4), number(8));
        let [degree, fractional_bits, flags] = [header[12], header[13], header[14]];
        if !(2..=4).contains(&version) {
            return bad(
                "version",
                format!("{version} is not supported: Relume reads SPZ 2 to 4; export as PLY"),
            );
        }
        if count > MAX_SPLATS {
            return bad("number of splats", format!("{count} is more than {MAX_SPLATS}; export as PLY"));
        }
        if degree > MAX_DEGREE {
            return bad("SH degree", format!("{degree} is more than {MAX_DEGREE}"));
        }
        if fractional_bits > 24 {
            return bad("fractional bits", format!("{fractional_bits} are more than 24"));
        }
        Ok(Self { version, count: count as usize, degree: degree.into(), fractional_bits, flags })
    }

    fn rotation_bytes(&self) -> usize {
        if self.version == 2 { 3 } else { 4 }
    }

    /// Names and lengths of the blocks, in the order of the file.
    fn blocks(&self) -> [(&'static str, usize); 6] {
        let harmonics = 3 * (sh_count(self.degree) - 1);
        [
            ("positions", 9),
            ("opacities", 1),
            ("colours", 3),
            ("scales", 3),
            ("rotations", self.rotation_bytes()),
            ("SH coefficients", harmonics),
        ]
        .map(|(name, bytes)| (name, bytes * self.count))
    }

    fn with(&self, blocks: [Vec<u8>; 6]) -> SpzBlocks {
        let [positions, opacities, colours, scales, rotations, harmonics] = blocks;
        SpzBlocks {
            count: self.count,
            degree: self.degree,
            fractional_bits: self.fractional_bits,
            is_antialiased: self.flags & ANTIALIASED != 0,
            has_extensions: self.flags & EXTENSIONS != 0,
            rotation_bytes: self.rotation_bytes(),
            positions,
            opacities,
            colours,
            scales,
            rotations,
            harmonics,
        }
    }
}

/// True for the signature, bare or at the start of a gzip stream.
pub(super) fn is_spz(bytes: &[u8]) -> bool {
    let mut start = [0; 4];
    bytes.starts_with(MAGIC)
        || bytes.starts_with(GZIP) && GzDecoder::new(bytes).read_exact(&mut start).is_ok() && start == MAGIC
}

/// Unpacks the blocks of a file.
///
/// # Errors
/// Names the field of the header that is out of range, or the block that is truncated or corrupt.
pub(super) fn read(bytes: &[u8]) -> Result<SpzBlocks, PlyError> {
    if bytes.starts_with(GZIP) {
        return read_sequence(&mut GzDecoder::new(bytes));
    }
    if SpzHeader::read(bytes)?.version < 4 {
        return read_sequence(&mut &*bytes);
    }
    read_streams(bytes)
}

/// Reads the header of 16 bytes and the blocks after it.
fn read_sequence(file: &mut dyn Read) -> Result<SpzBlocks, PlyError> {
    let mut start = [0; SHORT_HEADER];
    if file.read_exact(&mut start).is_err() {
        return bad("header", "is truncated");
    }
    let header = SpzHeader::read(&start)?;
    if header.version >= 4 {
        return bad("version", "4 inside gzip is not SPZ");
    }
    let mut blocks: [Vec<u8>; 6] = Default::default();
    for (block, (name, length)) in blocks.iter_mut().zip(header.blocks()) {
        *block = read_block(file, name, length)?;
    }
    Ok(header.with(blocks))
}

/// Reads the streams of version 4.
fn read_streams(bytes: &[u8]) -> Result<SpzBlocks, PlyError> {
    let header = SpzHeader::read(bytes)?;
    let expected = header.blocks();
    let expected = if header.degree == 0 { &expected[..5] } else { &expected[..] };
    let Some(long) = bytes.first_chunk::<LONG_HEADER>() else { return bad("header", "is truncated") };
    let stream_count = usize::from(long[15]);
    if stream_count != expected.len() {
        let reason =
            format!("{stream_count} streams for SH degree {}, not {}", header.degree, expected.len());
        return bad("number of streams", reason);
    }
    let contents_at = u32::from_le_bytes(std::array::from_fn(|k| long[16 + k])) as usize;
    let contents = bytes.get(contents_at..).unwrap_or_default();
    if contents_at < LONG_HEADER || contents.len() < 16 * stream_count {
        return bad("table of contents", "lies outside the file");
    }
    let (contents, mut streams) = contents.split_at(16 * stream_count);
    let mut blocks: [Vec<u8>; 6] = Default::default();
    for ((block, (name, length)), entry) in blocks.iter_mut().zip(expected).zip(contents.as_chunks::<16>().0)
    {
        let number = |at: usize| u64::from_le_bytes(std::array::from_fn(|k| entry[at + k]));
        let packed = usize::try_from(number(0)).ok().and_then(|packed| streams.split_at_checked(packed));
        let Some((stream, rest)) = packed else { return bad(*name, "are truncated") };
        if number(8) != *length as u64 {
            return bad(*name, format!("have {} bytes, not {length}", number(8)));
        }
        match StreamingDecoder::new(stream) {
            Ok(mut decoder) => *block = read_block(&mut decoder, name, *length)?,
            Err(error) => return bad(*name, error.to_string()),
        }
        streams = rest;
    }
    Ok(header.with(blocks))
}

/// Reads exactly `length` bytes. Memory grows with the bytes that arrive.
fn read_block(file: &mut dyn Read, name: &str, length: usize) -> Result<Vec<u8>, PlyError> {
    let mut block = Vec::new();
    match file.take(length as u64).read_to_end(&mut block) {
        Ok(read) if read == length => Ok(block),
        Ok(_) => bad(name, "are truncated"),
        Err(error) => bad(name, error.to_string()),
    }
}
