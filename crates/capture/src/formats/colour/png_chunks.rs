//! The chunks of a PNG that state its colour space, apart from ICC profiles: cICP, sRGB, gAMA and cHRM
//! (Portable Network Graphics, third edition, section 11.3.2).

/// What the chunks state.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct PngColour {
    /// Colour primaries and transfer function, codes of ITU-T H.273.
    pub cicp: Option<[u8; 2]>,
    /// Whether the chunk sRGB is present.
    pub is_srgb: bool,
    /// Exponent of the encoding, light to value; 0.45455 for common displays.
    pub gamma: Option<f64>,
    /// CIE x and y of white, red, green and blue.
    pub chromaticities: Option<[[f64; 2]; 4]>,
}

/// Reads the chunks before the pixels. Damaged chunks count as absent.
pub(super) fn read(bytes: &[u8]) -> PngColour {
    const SIGNATURE: usize = 8;
    let (mut found, mut at) = (PngColour::default(), SIGNATURE);
    while let Some((kind, data, next)) = chunk(bytes, at) {
        match kind {
            b"cICP" => found.cicp = data.first_chunk().copied(),
            b"sRGB" => found.is_srgb = true,
            b"gAMA" => found.gamma = number(data, 0).filter(|gamma| (0.1..=10.0).contains(gamma)),
            b"cHRM" => found.chromaticities = chromaticities(data),
            b"IDAT" | b"IEND" => break,
            _ => {}
        }
        at = next;
    }
    found
}

/// Kind and data of the chunk at a position, and the position after it.
fn chunk(bytes: &[u8], at: usize) -> Option<(&[u8; 4], &[u8], usize)> {
    let length = u32::from_be_bytes(*bytes.get(at..)?.first_chunk()?) as usize;
    let kind = bytes.get(at + 4..)?.first_chunk()?;
    let end = (at + 8).checked_add(length)?;
    Some((kind, bytes.get(at + 8..end)?, end.checked_add(4)?))
}

/// The number at `index` of a chunk of 32-bit integers, in 100,000ths.
fn number(data: &[u8], index: usize) -> Option<f64> {
    Some(f64::from(u32::from_be_bytes(*data.get(4 * index..)?.first_chunk()?)) / 1e5)
}

fn chromaticities(data: &[u8]) -> Option<[[f64; 2]; 4]> {
    let mut out = [[0.0; 2]; 4];
    for (i, value) in out.as_flattened_mut().iter_mut().enumerate() {
        *value = number(data, i)?;
    }
    // y is a divisor.
    out.iter().all(|[x, y]| (0.0..=1.0).contains(x) && (1e-5..=1.0).contains(y)).then_some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A PNG header with chunks, whose checksums are 0.
    fn png(chunks: &[(&[u8; 4], Vec<u8>)]) -> Vec<u8> {
        let mut out = b"\x89PNG\r\n\x1a\n".to_vec();
        for (kind, data) in chunks {
            out.extend((data.len() as u32).to_be_bytes());
            out.extend([&kind[..], data, &[0; 4]].concat());
        }
        out
    }

    fn numbers(values: &[u32]) -> Vec<u8> {
        values.iter().flat_map(|v| v.to_be_bytes()).collect()
    }

    #[test]
    fn chunks_before_the_pixels_are_read() {
        let chrm = numbers(&[31_270, 32_900, 68_000, 32_000, 26_500, 69_000, 15_000, 6_000]);
        let found = read(&png(&[
            (b"IHDR", vec![0; 13]),
            (b"cICP", vec![12, 13, 0, 1]),
            (b"gAMA", numbers(&[45_455])),
            (b"cHRM", chrm),
            (b"IDAT", vec![]),
            (b"sRGB", vec![0]),
        ]));
        assert_eq!((found.cicp, found.is_srgb, found.gamma), (Some([12, 13]), false, Some(0.454_55)));
        assert_eq!(found.chromaticities.unwrap()[1], [0.68, 0.32]);
    }

    #[test]
    fn damaged_chunks_count_as_absent() {
        let damaged = [(b"gAMA", numbers(&[0])), (b"cHRM", numbers(&[31_270, 0])), (b"cICP", vec![1])];
        assert_eq!(read(&png(&damaged)), PngColour::default());
        let mut long = png(&[(b"gAMA", numbers(&[100_000]))]);
        assert_eq!(read(&long).gamma, Some(1.0), "the control");
        long[8..12].copy_from_slice(&u32::MAX.to_be_bytes());
        assert_eq!(read(&long), PngColour::default(), "the length is beyond the file");
    }
}
