//! The header of a HEIC or AVIF file: boxes of ISO/IEC 14496-12 with the item properties of ISO/IEC 23008-12.

use crate::formats::ImageFileError;
use crate::formats::colour::StatedColour;

/// Brands of files that contain a picture.
const BRANDS: [&[u8; 4]; 11] =
    [b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"mif2", b"msf1", b"avif", b"avis"];
/// Greatest number of properties that are read.
const MAX_PROPERTIES: usize = 4096;

/// The header of a HEIC or AVIF file.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::formats) struct HeifHeader {
    /// Width and height of the picture as it is shown: rotated and cropped, pixels.
    pub size: (u32, u32),
    /// Bits of a channel; 8 if the file does not state them.
    pub bits: u8,
    /// The stated colour space.
    pub colour: Option<StatedColour>,
}

/// Whether a file is a HEIC or AVIF picture, by its first bytes.
pub(crate) fn is_heif(bytes: &[u8]) -> bool {
    let Some(b"ftyp") = bytes.get(4..8).and_then(|kind| kind.first_chunk()) else { return false };
    // The size of the box; 0 is for all bytes, and 1 for a size of 64 bits. The box may be longer than the bytes that were
    // read.
    let length = match number(bytes, 0) {
        Some(0 | 1) | None => bytes.len(),
        Some(size) => bytes.len().min(size as usize),
    };
    let data = bytes.get(8..length).unwrap_or_default();
    // The minor version follows the main brand.
    let brands = data.chunks_exact(4).enumerate().filter(|(i, _)| *i != 1);
    let is_picture = |brand: &[u8]| BRANDS.iter().any(|known| *known == brand);
    brands.take(64).any(|(_, brand)| is_picture(brand))
}

/// The name of the kind of a file for which [`is_heif`].
pub(super) fn kind_name(bytes: &[u8]) -> &'static str {
    match bytes.get(8..11) {
        Some(b"avi") => "AVIF",
        _ => "HEIC",
    }
}

/// Reads the header.
///
/// # Errors
/// [`ImageFileError::Damaged`] if the boxes of the main picture are missing, truncated or inconsistent.
pub(in crate::formats) fn header(bytes: &[u8]) -> Result<HeifHeader, ImageFileError> {
    let damaged = |what: &str| ImageFileError::Damaged(format!("the {} header {what}", kind_name(bytes)));
    let meta =
        child(bytes, b"meta").and_then(|meta| meta.get(4..)).ok_or_else(|| damaged("is incomplete"))?;
    let item = child(meta, b"pitm").and_then(primary_item).ok_or_else(|| damaged("names no main picture"))?;
    let properties = child(meta, b"iprp").ok_or_else(|| damaged("has no item properties"))?;
    let all = child(properties, b"ipco").ok_or_else(|| damaged("has no item properties"))?;
    let all: Vec<_> = Boxes(all).take(MAX_PROPERTIES).collect();
    let indices = Boxes(properties)
        .filter(|(kind, _)| *kind == b"ipma")
        .find_map(|(_, data)| associations(data, item))
        .ok_or_else(|| damaged("has no properties of the main picture"))?;
    let own = indices.iter().filter_map(|index| all.get(index.checked_sub(1)?));
    from_properties(own.copied()).ok_or_else(|| damaged("states no size"))
}

/// The header from the properties of the main picture. Rotations and crops apply in the order of the properties.
fn from_properties<'a>(properties: impl Iterator<Item = (&'a [u8; 4], &'a [u8])>) -> Option<HeifHeader> {
    let (mut size, mut bits, mut icc, mut coded) = (None, 8, None, None);
    for (kind, data) in properties {
        match (kind, size) {
            (b"ispe", _) => size = Some((number(data, 4)?, number(data, 8)?)),
            (b"irot", Some((width, height))) if data.first()? & 1 == 1 => size = Some((height, width)),
            (b"clap", Some(_)) => size = Some((ratio(data, 0)?, ratio(data, 8)?)),
            (b"pixi", _) => bits = data.get(5..)?.iter().copied().max().unwrap_or(8),
            (b"colr", _) => match data.get(..4)? {
                b"prof" | b"rICC" => icc = Some(StatedColour::Icc(data[4..].to_vec())),
                b"nclx" => coded = coded_colour(&data[4..]),
                _ => {}
            },
            _ => {}
        }
    }
    let size = size.filter(|(width, height)| *width > 0 && *height > 0)?;
    Some(HeifHeader { size, bits, colour: icc.or(coded) })
}

/// Primaries and transfer function; `None` if both are unspecified (2).
fn coded_colour(data: &[u8]) -> Option<StatedColour> {
    let &[0, primaries, 0, transfer] = data.first_chunk()? else { return None };
    ((primaries, transfer) != (2, 2)).then_some(StatedColour::Coded { primaries, transfer })
}

/// A 32-bit integer at a position.
fn number(data: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(*data.get(at..)?.first_chunk()?))
}

/// A rounded fraction of two 32-bit integers at a position.
fn ratio(data: &[u8], at: usize) -> Option<u32> {
    let (above, below) = (number(data, at)?, number(data, at + 4)?);
    (below > 0).then(|| (f64::from(above) / f64::from(below)).round() as u32)
}

fn primary_item(data: &[u8]) -> Option<u32> {
    match data.first()? {
        0 => Some(u32::from(u16::from_be_bytes(*data.get(4..)?.first_chunk()?))),
        _ => number(data, 4),
    }
}

/// The indices of the properties of an item, from 1, in a box of associations.
fn associations(data: &[u8], item: u32) -> Option<Vec<usize>> {
    let (version, is_wide) = (*data.first()?, data.get(3)? & 1 == 1);
    let mut rest = data.get(8..)?;
    while !rest.is_empty() {
        let (id, after) = match version {
            0 => (u32::from(u16::from_be_bytes(*rest.first_chunk()?)), rest.get(2..)?),
            _ => (number(rest, 0)?, rest.get(4..)?),
        };
        let count = usize::from(*after.first()?);
        let length = count * if is_wide { 2 } else { 1 };
        let own = after.get(1..1 + length)?;
        if id == item {
            // The highest bit says that a property is essential.
            return Some(match is_wide {
                true => {
                    own.chunks_exact(2).map(|p| usize::from(p[0] & 0x7f) << 8 | usize::from(p[1])).collect()
                }
                false => own.iter().map(|p| usize::from(p & 0x7f)).collect(),
            });
        }
        rest = &after[1 + length..];
    }
    None
}

/// The data of the first box of a kind.
fn child<'a>(data: &'a [u8], wanted: &[u8; 4]) -> Option<&'a [u8]> {
    Boxes(data).find(|(kind, _)| *kind == wanted).map(|(_, data)| data)
}

/// Kind, data and remainder of the box at the start; `None` if it is incomplete.
fn first_box(data: &[u8]) -> Option<(&[u8; 4], &[u8], &[u8])> {
    let kind = data.get(4..)?.first_chunk()?;
    let (start, end) = match number(data, 0)? {
        0 => (8, data.len()),
        1 => (16, usize::try_from(u64::from_be_bytes(*data.get(8..)?.first_chunk()?)).ok()?),
        size => (8, size as usize),
    };
    Some((kind, data.get(start..end)?, &data[end..]))
}

/// The boxes of a sequence, up to the first incomplete one.
struct Boxes<'a>(&'a [u8]);

impl<'a> Iterator for Boxes<'a> {
    type Item = (&'a [u8; 4], &'a [u8]);

    fn next(&mut self) -> Option<Self::Item> {
        let (kind, data, rest) = first_box(self.0)?;
        self.0 = rest;
        Some((kind, data))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    fn boxed(kind: &[u8; 4], parts: &[&[u8]]) -> Vec<u8> {
        let data = parts.concat();
        [&(data.len() as u32 + 8).to_be_bytes()[..], kind, &data].concat()
    }

    /// A HEIC header of `size` pixels with further properties of the main picture, item 7.
    pub(in crate::formats::heif) fn heic(size: (u32, u32), more: &[Vec<u8>]) -> Vec<u8> {
        let ispe = boxed(b"ispe", &[&[0; 4], &size.0.to_be_bytes(), &size.1.to_be_bytes()]);
        // The thumbnail, item 8, has the first property; the main picture has the others.
        let small = boxed(b"ispe", &[&[0; 4], &[0, 0, 0, 16], &[0, 0, 0, 9]]);
        let ipco = boxed(b"ipco", &[&small, &ispe, &more.concat()]);
        let own: Vec<u8> = (0..=more.len() as u8).map(|i| 0x80 | (i + 2)).collect();
        let ipma = boxed(b"ipma", &[&[0; 4], &[0, 0, 0, 2], &[0, 8, 1, 1], &[0, 7, own.len() as u8], &own]);
        let pitm = boxed(b"pitm", &[&[0, 0, 0, 0, 0, 7]]);
        let meta = boxed(b"meta", &[&[0; 4], &pitm, &boxed(b"iprp", &[&ipco, &ipma])]);
        [boxed(b"ftyp", &[b"heic", &[0; 4], b"mif1"]), meta].concat()
    }

    #[test]
    fn size_is_that_of_the_main_picture_as_it_is_shown() {
        let quarter = boxed(b"irot", &[&[3]]);
        assert_eq!(header(&heic((4032, 3024), &[])).unwrap().size, (4032, 3024));
        assert_eq!(header(&heic((4032, 3024), &[quarter])).unwrap().size, (3024, 4032));
        let half = boxed(b"irot", &[&[2]]);
        assert_eq!(header(&heic((40, 30), &[half])).unwrap().size, (40, 30), "a half turn");
        let numbers = [38u32, 1, 56, 2, 0, 1, 0, 1].map(u32::to_be_bytes);
        let crop = boxed(b"clap", &[numbers.as_flattened()]);
        assert_eq!(header(&heic((40, 30), &[crop])).unwrap().size, (38, 28));
    }

    #[test]
    fn bits_and_colour_are_read_and_a_profile_wins() {
        let pixi = boxed(b"pixi", &[&[0, 0, 0, 0, 3, 10, 10, 10]]);
        let coded = boxed(b"colr", &[b"nclx", &[0, 12, 0, 13, 0, 6, 0x80]]);
        let icc = boxed(b"colr", &[b"prof", b"a profile"]);
        let found = header(&heic((4, 3), &[pixi, coded.clone()])).unwrap();
        assert_eq!(
            (found.bits, found.colour),
            (10, Some(StatedColour::Coded { primaries: 12, transfer: 13 }))
        );
        let found = header(&heic((4, 3), &[icc, coded])).unwrap();
        assert_eq!((found.bits, found.colour), (8, Some(StatedColour::Icc(b"a profile".to_vec()))));
        let unspecified = boxed(b"colr", &[b"nclx", &[0, 2, 0, 2, 0, 6, 0x80]]);
        assert_eq!(header(&heic((4, 3), &[unspecified])).unwrap().colour, None);
    }

    #[test]
    fn heic_and_avif_are_told_from_clips() {
        assert!(is_heif(&heic((4, 3), &[])));
        assert!(is_heif(b"\0\0\0\x18ftypMiHE\0\0\0\0mif1heic"), "by a compatible brand");
        assert!(is_heif(b"\0\0\0\x14ftypavif\0\0\0\0mif1"));
        assert!(is_heif(b"\0\0\x10\0ftypavif\0\0\0\0mif1"), "a box longer than the bytes");
        assert!(!is_heif(b"\0\0\0\x14ftypisom\0\0\0\0mp42heic"), "after the box");
        assert!(!is_heif(b"\0\0\0\x14ftypisom\0\0\0\0mp42"));
        assert!(!is_heif(b"\0\0\0\x14ftypqt  mif1qt  "), "the minor version is no brand");
    }

    #[test]
    fn truncated_and_changed_headers_never_panic() {
        let whole = heic((40, 30), &[boxed(b"irot", &[&[1]]), boxed(b"clap", &[&[0; 32]])]);
        for length in 0..whole.len() {
            assert!(header(&whole[..length]).is_err(), "{length}");
            for value in [0, 1, 2, 0x7f, 0xff] {
                let mut changed = whole.clone();
                changed[length] = value;
                let _ = (is_heif(&changed), header(&changed));
            }
        }
    }
}
