//! Equirectangular environment maps: converts Radiance `.hdr` and OpenEXR bytes to [`EnvMap`] and back.

use std::io::Cursor;

use image::codecs::hdr::{HdrDecoder, HdrEncoder};
use image::{ImageDecoder, Rgb};

use crate::formats::{ImageFileError, exr_image};
use relume_scene::{EnvMap, EnvMapError};

/// Largest width of a map, texels.
pub const MAX_WIDTH: u32 = 16_384;
/// Largest height of a map, texels.
pub const MAX_HEIGHT: u32 = 8_192;

/// Errors of reading and writing environment files.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EnvironmentFileError {
    /// Neither Radiance nor OpenEXR.
    #[error("environment: not a Radiance .hdr or OpenEXR file")]
    UnknownKind,
    /// Larger than [`MAX_WIDTH`] x [`MAX_HEIGHT`] according to the header.
    #[error("environment: {width}x{height} is larger than {MAX_WIDTH}x{MAX_HEIGHT}")]
    TooLarge {
        /// Width according to the header.
        width: u32,
        /// Height according to the header.
        height: u32,
    },
    /// The file is truncated or corrupt, or could not be written.
    #[error("environment: {0}")]
    File(#[from] ImageFileError),
    /// The values are unusable.
    #[error(transparent)]
    Values(#[from] EnvMapError),
}

/// A map read from a file, with warnings.
#[derive(Debug, Clone, PartialEq)]
pub struct LoadedEnvironment {
    /// The map.
    pub map: EnvMap,
    /// Values that were corrected, and unusual properties.
    pub warnings: Vec<String>,
}

/// Reads an equirectangular map; the format is detected from the content. Negative values become 0 with a warning.
///
/// # Errors
/// [`EnvironmentFileError`]; NaN and infinity are refused with the texel named.
pub fn decode(bytes: &[u8]) -> Result<LoadedEnvironment, EnvironmentFileError> {
    let (width, height, texels) = if exr_image::is_exr(bytes) {
        let (width, height) = exr_image::dimensions(bytes)?;
        check_size(width, height)?;
        let (width, height, pixels) = exr_image::decode_rgba(bytes)?;
        (width, height, pixels.into_iter().map(|[r, g, b, _]| [r, g, b]).collect())
    } else if bytes.starts_with(b"#?") {
        decode_radiance(bytes)?
    } else {
        return Err(EnvironmentFileError::UnknownKind);
    };
    let (map, stats) = EnvMap::new(width as usize, height as usize, texels)?;
    let mut warnings = Vec::new();
    if stats.clamped_negatives > 0 {
        warnings.push(format!("{} negative colour values were set to 0", stats.clamped_negatives));
    }
    if width != 2 * height {
        warnings.push(format!("{width}x{height} is not 2:1; it is treated as a full sphere"));
    }
    Ok(LoadedEnvironment { map, warnings })
}

/// Bytes of memory that [`decode`] takes in addition to the file itself, from the header.
///
/// # Errors
/// As [`decode`], for what the header shows.
pub fn decoding_bytes(bytes: &[u8]) -> Result<u64, EnvironmentFileError> {
    let ((width, height), read) = if exr_image::is_exr(bytes) {
        let size = exr_image::dimensions(bytes)?;
        // The decoded channels, then four floats a texel.
        (size, exr_image::decoded_bytes(bytes)? + texels(size) * 16)
    } else if bytes.starts_with(b"#?") {
        let decoder = HdrDecoder::new(Cursor::new(bytes));
        let size = decoder.map_err(|e| ImageFileError::Damaged(e.to_string()))?.dimensions();
        (size, texels(size) * 12)
    } else {
        return Err(EnvironmentFileError::UnknownKind);
    };
    check_size(width, height)?;
    // The map itself.
    Ok(read + texels((width, height)) * 12)
}

fn texels((width, height): (u32, u32)) -> u64 {
    u64::from(width) * u64::from(height)
}

fn check_size(width: u32, height: u32) -> Result<(), EnvironmentFileError> {
    if width > MAX_WIDTH || height > MAX_HEIGHT {
        return Err(EnvironmentFileError::TooLarge { width, height });
    }
    Ok(())
}

type Texels = (u32, u32, Vec<[f32; 3]>);

fn decode_radiance(bytes: &[u8]) -> Result<Texels, EnvironmentFileError> {
    let damaged = |e: image::ImageError| ImageFileError::Damaged(e.to_string());
    let decoder = HdrDecoder::new(Cursor::new(bytes)).map_err(damaged)?;
    let (width, height) = decoder.dimensions();
    check_size(width, height)?;
    let mut raw = vec![0u8; decoder.total_bytes() as usize];
    decoder.read_image(&mut raw).map_err(damaged)?;
    let channel = |texel: &[u8; 12], c: usize| f32::from_ne_bytes(std::array::from_fn(|k| texel[4 * c + k]));
    let texels = raw.as_chunks::<12>().0.iter().map(|texel| std::array::from_fn(|c| channel(texel, c)));
    Ok((width, height, texels.collect()))
}

/// The map as a Radiance file: 8-bit mantissas under a shared exponent, about 1 % of the brightest channel.
///
/// # Errors
/// When the encoder refuses the size.
pub fn encode_hdr(map: &EnvMap) -> Result<Vec<u8>, EnvironmentFileError> {
    let pixels: Vec<Rgb<f32>> = map.texels().iter().map(|t| Rgb(*t)).collect();
    let mut out = Vec::new();
    HdrEncoder::new(&mut out)
        .encode(&pixels, map.width(), map.height())
        .map_err(|e| ImageFileError::Encode(e.to_string()))?;
    Ok(out)
}

/// The map as an OpenEXR file of f32 values, exact.
///
/// # Errors
/// When the encoder refuses the size.
pub fn encode_exr(map: &EnvMap) -> Result<Vec<u8>, EnvironmentFileError> {
    Ok(exr_image::encode_rgb(map.width(), map.height(), map.texels())?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> EnvMap {
        EnvMap::from_fn(16, 8, |d| [(d.x + 1.5) as f32, (d.z + 2.0) as f32 * 100.0, 0.01])
    }

    #[test]
    fn exr_round_trip_is_exact_and_hdr_is_within_one_percent() {
        let map = example();
        assert_eq!(decode(&encode_exr(&map).unwrap()).unwrap().map, map);
        let hdr = decode(&encode_hdr(&map).unwrap()).unwrap();
        for (a, b) in map.texels().iter().zip(hdr.map.texels()) {
            let peak = a.iter().copied().fold(0.0, f32::max);
            assert!((0..3).all(|k| (a[k] - b[k]).abs() <= 0.01 * peak), "{a:?} {b:?}");
        }
        assert!(hdr.warnings.is_empty());
    }

    #[test]
    fn nan_and_infinity_are_refused_with_their_texel() {
        for poison in [f32::NAN, f32::INFINITY] {
            let mut texels = example().texels().to_vec();
            texels[16 * 3 + 5][1] = poison;
            let error = decode(&exr_image::encode_rgb(16, 8, &texels).unwrap()).unwrap_err();
            assert_eq!(error, EnvironmentFileError::Values(EnvMapError::NotFinite { x: 5, y: 3 }));
        }
    }

    #[test]
    fn negative_values_are_clamped_with_a_warning() {
        let loaded = decode(&exr_image::encode_rgb(2, 1, &[[-1.0, 0.5, 2.0]; 2]).unwrap()).unwrap();
        assert_eq!(loaded.map.texels()[1], [0.0, 0.5, 2.0]);
        assert!(loaded.warnings[0].contains("2 negative"), "{:?}", loaded.warnings);
    }

    #[test]
    fn other_files_and_huge_headers_are_refused() {
        assert_eq!(decode(b"").unwrap_err(), EnvironmentFileError::UnknownKind);
        assert_eq!(decode(b"{\"a\": 1}").unwrap_err(), EnvironmentFileError::UnknownKind);
        let huge = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 20000 +X 40000\n";
        let expected = EnvironmentFileError::TooLarge { width: 40_000, height: 20_000 };
        assert_eq!(decode(huge).unwrap_err(), expected);
    }

    #[test]
    fn truncated_radiance_files_are_refused() {
        let bytes = encode_hdr(&example()).unwrap();
        for cut in 0..bytes.len() {
            assert!(decode(&bytes[..cut]).is_err(), "cut at {cut}");
        }
    }
}
