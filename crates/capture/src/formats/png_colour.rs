//! States the colour space of a PNG (W3C PNG, third edition, 11.3.2): without it, a reader must guess what its values mean.

use flate2::Crc;

use crate::formats::ImageFileError;

/// The signature of a PNG and its first chunk, IHDR: 8 bytes, then length, name, 13 bytes of data and CRC.
const HEADER_LENGTH: usize = 8 + 4 + 4 + 13 + 4;
/// The rendering intent `perceptual`. It matters only to readers that convert to a smaller gamut.
const PERCEPTUAL: u8 = 0;
/// The exponent 1 of linear values, as a multiple of 1/100,000.
const GAMMA_1: u32 = 100_000;

/// Meaning of the values of a PNG.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PngColour {
    /// Colours that are encoded for display, sRGB: chunk `sRGB`.
    Srgb,
    /// Linear light, or values that are no colours, such as normals, depths and roughness: chunk `gAMA` with the exponent 1.
    Linear,
}

/// Adds the chunk that states `colour` to a PNG without one. All other bytes stay the same.
///
/// # Errors
/// [`ImageFileError::Encode`] if the bytes do not begin as a PNG does.
pub fn with_colour(png: &[u8], colour: PngColour) -> Result<Vec<u8>, ImageFileError> {
    let header =
        png.get(..HEADER_LENGTH).filter(|header| header.starts_with(b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR"));
    let Some(header) = header else {
        return Err(ImageFileError::Encode("not a PNG: it cannot state a colour space".to_owned()));
    };
    let chunk = match colour {
        PngColour::Srgb => chunk(*b"sRGB", &[PERCEPTUAL]),
        PngColour::Linear => chunk(*b"gAMA", &GAMMA_1.to_be_bytes()),
    };
    Ok([header, chunk.as_slice(), &png[HEADER_LENGTH..]].concat())
}

/// A chunk: the length of the data, the name, the data, and the CRC of name and data.
fn chunk(name: [u8; 4], data: &[u8]) -> Vec<u8> {
    let mut crc = Crc::new();
    crc.update(&name);
    crc.update(data);
    // The data are a few bytes.
    let length = data.len() as u32;
    [&length.to_be_bytes()[..], &name, data, &crc.sum().to_be_bytes()].concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::image_file::{encode_png, encode_png16};

    /// The names of the chunks, each with its data.
    fn chunks(png: &[u8]) -> Vec<(String, Vec<u8>)> {
        let (mut rest, mut found) = (&png[8..], Vec::new());
        while !rest.is_empty() {
            let length = u32::from_be_bytes(rest[..4].try_into().unwrap()) as usize;
            let mut crc = Crc::new();
            crc.update(&rest[4..8 + length]);
            assert_eq!(rest[8 + length..12 + length], crc.sum().to_be_bytes(), "the CRC");
            let name = String::from_utf8(rest[4..8].to_vec()).unwrap();
            found.push((name, rest[8..8 + length].to_vec()));
            rest = &rest[12 + length..];
        }
        found
    }

    #[test]
    fn a_png_states_its_colour_space_and_is_otherwise_unchanged() {
        let plain = encode_png(2, 1, &[[1u8, 2, 3], [250, 4, 5]]).unwrap();
        let deep = encode_png16(2, 1, &[[1u16], [40_001]]).unwrap();
        for (png, colour, name, data) in [
            (&plain, PngColour::Srgb, "sRGB", vec![0]),
            (&plain, PngColour::Linear, "gAMA", 100_000u32.to_be_bytes().to_vec()),
            (&deep, PngColour::Linear, "gAMA", 100_000u32.to_be_bytes().to_vec()),
        ] {
            let before = chunks(png);
            assert!(before.iter().all(|(name, _)| name != "sRGB" && name != "gAMA"), "the control");
            let mut after = chunks(&with_colour(png, colour).unwrap());
            assert_eq!(after.remove(1), (name.to_owned(), data), "after IHDR");
            assert_eq!(after, before);
            let pixels = |png: &[u8]| image::load_from_memory(png).unwrap().into_rgba16().into_raw();
            assert_eq!(pixels(&with_colour(png, colour).unwrap()), pixels(png));
        }
        // As other encoders write the chunk.
        let known = b"\0\0\0\x01sRGB\0\xae\xce\x1c\xe9";
        let srgb = with_colour(&plain, PngColour::Srgb).unwrap();
        assert_eq!(srgb[HEADER_LENGTH..HEADER_LENGTH + known.len()], known[..]);
    }

    #[test]
    fn bytes_that_are_no_png_are_refused() {
        let png = encode_png(1, 1, &[[1u8, 2, 3]]).unwrap();
        assert!(with_colour(&png, PngColour::Srgb).is_ok(), "the control");
        for bytes in
            [&[][..], &png[..HEADER_LENGTH - 1], b"\xff\xd8\xff\xe0 a JPEG that is longer than a header"]
        {
            assert!(with_colour(bytes, PngColour::Srgb).is_err(), "{bytes:?}");
        }
    }
}
