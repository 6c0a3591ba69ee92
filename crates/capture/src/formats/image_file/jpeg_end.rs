//! Finds the end of a JPEG's picture. The decoder fills the missing part of a truncated picture with grey, so a truncated
//! file must be recognised before it is decoded.
//!
//! The layout is that of ITU-T T.81, annex B: segments with a length, then scans of entropy-coded data, then the marker EOI.

/// Start of image.
const SOI: u8 = 0xd8;
/// End of image.
const EOI: u8 = 0xd9;
/// A marker without a segment.
const TEM: u8 = 0x01;

/// Whether the picture ends with its marker EOI. Bytes after it do not matter: phones append clips and further pictures. A
/// file whose data are complete except for EOI counts as truncated.
pub(super) fn is_complete(bytes: &[u8]) -> bool {
    let mut at = 0;
    loop {
        // Entropy-coded data contain 0xff only before 0 or as a part of a restart marker, so this search passes over them.
        let Some(marker) = next_marker(bytes, at) else { return false };
        at = marker.1;
        match marker.0 {
            EOI => return true,
            SOI | TEM | 0xd0..=0xd7 => {}
            _ => {
                let Some(&[high, low]) = bytes.get(at..at + 2) else { return false };
                let length = usize::from(u16::from_be_bytes([high, low]));
                if length < 2 {
                    return false;
                }
                at += length;
            }
        }
    }
}

/// The next marker at or after `at`, and the position after it. A marker is 0xff and a byte that is neither 0 nor 0xff.
fn next_marker(bytes: &[u8], at: usize) -> Option<(u8, usize)> {
    let rest = bytes.get(at..)?;
    let found = rest.windows(2).position(|pair| pair[0] == 0xff && !matches!(pair[1], 0 | 0xff))?;
    Some((rest[found + 1], at + found + 2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::image_file::encode_jpeg;

    fn jpeg() -> Vec<u8> {
        let pixels: Vec<[u8; 3]> = (0..64 * 48u32).map(|i| [(i * 7) as u8, (i / 5) as u8, 90]).collect();
        encode_jpeg(64, 48, &pixels, 90).unwrap()
    }

    #[test]
    fn every_truncation_of_a_jpeg_is_found() {
        let whole = jpeg();
        assert!(is_complete(&whole));
        for length in 0..whole.len() {
            assert!(!is_complete(&whole[..length]), "{length} of {} bytes", whole.len());
        }
    }

    #[test]
    fn bytes_after_the_picture_and_thumbnails_do_not_matter() {
        let whole = jpeg();
        assert!(is_complete(&[&whole[..], b"ftypmp42 a clip"].concat()), "a motion photo");
        // A segment that contains a whole JPEG, as a thumbnail does.
        let length = ((whole.len() + 2) as u16).to_be_bytes();
        let mut with_thumbnail = [&whole[..2], &[0xff, 0xe1], &length, &whole].concat();
        let cut = with_thumbnail.len() + whole.len() / 2;
        with_thumbnail.extend(&whole[2..]);
        assert!(is_complete(&with_thumbnail));
        assert!(!is_complete(&with_thumbnail[..cut]), "the EOI of the thumbnail is not that of the picture");
    }
}
