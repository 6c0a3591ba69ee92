//! Equirectangular environment maps: converts Radiance `.hdr` and OpenEXR bytes to [`EnvMap`] and back.

use image::codecs::hdr::HdrEncoder;
use image::{ImageFormat, Rgb};

use crate::formats::exr_image::{EnvironmentMap, ExrImage};
use crate::formats::radiance::{self, RadiancePicture};
use crate::formats::{ImageFileError, exr_image, recognise_foreign};
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
    /// A picture of 8 or 16 bits, which is no light.
    #[error(
        "environment: is a {0} picture, whose values end at white; use the .hdr or .exr file of the light"
    )]
    DisplayReferred(&'static str),
    /// Larger than [`MAX_WIDTH`] x [`MAX_HEIGHT`] according to the header.
    #[error("environment: {width}x{height} is larger than {MAX_WIDTH}x{MAX_HEIGHT}")]
    TooLarge {
        /// Width according to the header.
        width: u32,
        /// Height according to the header.
        height: u32,
    },
    /// The size or the header shows another layout than equirectangular.
    #[error(
        "environment: {width}x{height} is {layout}; an equirectangular map is twice as wide as high; {remedy}"
    )]
    Layout {
        /// Width according to the header.
        width: u32,
        /// Height according to the header.
        height: u32,
        /// The layout that the map probably has.
        layout: &'static str,
        /// A way to an equirectangular map.
        remedy: &'static str,
    },
    /// The file is truncated, corrupt or of another kind, or could not be written.
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
    /// Values that were corrected or converted, and unusual properties.
    pub warnings: Vec<String>,
}

/// Reads an equirectangular map; the format is detected from the content. Negative values become 0 with a warning.
///
/// The colours of an OpenEXR file are its RGB (else its luminance), in the display window, converted to Rec.709 from the
/// primaries that the file states. The values of a Radiance file are divided by its exposure.
///
/// # Errors
/// [`EnvironmentFileError`]; NaN and infinity are refused with the texel named. Square maps and the layouts of cube maps
/// are refused by name, unless the file states that it is equirectangular.
pub fn decode(bytes: &[u8]) -> Result<LoadedEnvironment, EnvironmentFileError> {
    let kind = FileKind::of(bytes)?;
    let (width, height) = kind.dimensions(bytes)?;
    check_size(width, height)?;
    let (texels, stated, mut warnings): (Vec<[f32; 3]>, _, _) = match kind {
        FileKind::Exr => {
            let ExrImage { pixels, environment, notes, .. } = exr_image::decode(bytes)?;
            (pixels.into_iter().map(|[r, g, b, _]| [r, g, b]).collect(), environment, notes)
        }
        FileKind::Radiance => {
            let RadiancePicture { texels, notes, .. } = radiance::decode(bytes)?;
            (texels, None, notes)
        }
    };
    check_layout(width, height, stated)?;
    let (map, stats) = EnvMap::new(width as usize, height as usize, texels)?;
    if stats.clamped_negatives > 0 {
        warnings.push(format!("{} negative colour values were set to 0", stats.clamped_negatives));
    }
    if width != 2 * height && (width, height) != (1, 1) {
        warnings.push(format!("{width}x{height} is not 2:1; it is treated as a full sphere"));
    }
    Ok(LoadedEnvironment { map, warnings })
}

/// Bytes of memory that [`decode`] takes in addition to the file itself, from the header.
///
/// # Errors
/// As [`decode`], for what the header shows.
pub fn decoding_bytes(bytes: &[u8]) -> Result<u64, EnvironmentFileError> {
    let kind = FileKind::of(bytes)?;
    let (width, height) = kind.dimensions(bytes)?;
    check_size(width, height)?;
    let texels = u64::from(width) * u64::from(height);
    let read = match kind {
        FileKind::Exr => exr_image::decoded_bytes(bytes)?,
        FileKind::Radiance => texels * 12,
    };
    // The map itself.
    Ok(read.saturating_add(texels * 12))
}

/// A format of environment files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FileKind {
    Exr,
    Radiance,
}

impl FileKind {
    fn of(bytes: &[u8]) -> Result<Self, EnvironmentFileError> {
        if exr_image::is_exr(bytes) {
            return Ok(Self::Exr);
        }
        if radiance::is_radiance(bytes) {
            return Ok(Self::Radiance);
        }
        if bytes.is_empty() {
            return Err(ImageFileError::Empty.into());
        }
        if let Some(what) = recognise_foreign(bytes) {
            return Err(ImageFileError::Foreign(what).into());
        }
        Err(match image::guess_format(bytes) {
            Ok(ImageFormat::Png) => EnvironmentFileError::DisplayReferred("PNG"),
            Ok(ImageFormat::Jpeg) => EnvironmentFileError::DisplayReferred("JPEG"),
            Ok(ImageFormat::WebP) => EnvironmentFileError::DisplayReferred("WebP"),
            Ok(ImageFormat::Tiff) => EnvironmentFileError::File(ImageFileError::Unsupported(
                "is a TIFF picture; save the light as .hdr or .exr".to_owned(),
            )),
            _ => EnvironmentFileError::UnknownKind,
        })
    }

    fn dimensions(self, bytes: &[u8]) -> Result<(u32, u32), ImageFileError> {
        match self {
            Self::Exr => exr_image::dimensions(bytes),
            Self::Radiance => radiance::dimensions(bytes),
        }
    }
}

fn check_size(width: u32, height: u32) -> Result<(), EnvironmentFileError> {
    if width > MAX_WIDTH || height > MAX_HEIGHT {
        return Err(EnvironmentFileError::TooLarge { width, height });
    }
    Ok(())
}

/// Refuses maps that state or show another layout. A single texel is a uniform light in every layout.
fn check_layout(width: u32, height: u32, stated: Option<EnvironmentMap>) -> Result<(), EnvironmentFileError> {
    const CUBE: &str = "convert it, e.g. with `exrenvmap -latlong` of OpenEXR";
    let ratio = |w: u32, h: u32| u64::from(width) * u64::from(h) == u64::from(height) * u64::from(w);
    let layout = match stated {
        Some(EnvironmentMap::LatitudeLongitude) => None,
        Some(EnvironmentMap::Cube) => Some(("a cube map (attribute envmap)", CUBE)),
        None if (width, height) == (1, 1) => None,
        None if ratio(1, 1) => Some((
            "square, like a light probe (angular map), a mirror ball or a face of a cube",
            "convert it, e.g. in HDRShop or with `pfspanoramic angular+polar` of pfstools",
        )),
        None if ratio(6, 1) || ratio(1, 6) => Some(("a strip of six cube faces", CUBE)),
        None if ratio(4, 3) || ratio(3, 4) => {
            Some(("a cross of six cube faces, or an ordinary picture", "convert it to equirectangular"))
        }
        None => None,
    };
    match layout {
        Some((layout, remedy)) => Err(EnvironmentFileError::Layout { width, height, layout, remedy }),
        None => Ok(()),
    }
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
    use proptest::prelude::*;
    use relume_fixtures::cases_or;

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
        assert_eq!(decode(b"").unwrap_err(), EnvironmentFileError::File(ImageFileError::Empty));
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

    #[test]
    fn files_of_other_kinds_are_named() {
        let named = |bytes: &[u8]| decode(bytes).unwrap_err().to_string();
        let png = crate::formats::image_file::encode_png(2, 1, &[[1u8, 2, 3]; 2]).unwrap();
        assert!(named(&png).contains("PNG picture"), "{}", named(&png));
        assert!(named(b"version https://git-lfs.github.com/spec/v1\n").contains("git lfs pull"));
        assert!(named(b"<!DOCTYPE html><html></html>").contains("web page"));
    }

    #[test]
    fn other_layouts_are_refused_by_name() {
        let of = |width: usize, height: usize| {
            decode(&exr_image::encode_rgb(width, height, &vec![[0.5; 3]; width * height]).unwrap())
        };
        for (width, height, word) in
            [(8, 8, "square"), (24, 4, "strip"), (4, 24, "strip"), (16, 12, "cross"), (12, 16, "cross")]
        {
            let error = of(width, height).unwrap_err().to_string();
            assert!(error.contains(word) && error.contains("twice as wide"), "{error}");
        }
        assert_eq!(of(16, 8).unwrap().warnings, Vec::<String>::new(), "the control");
        assert!(of(16, 10).unwrap().warnings[0].contains("not 2:1"));
        assert!(of(1, 1).unwrap().warnings.is_empty(), "a uniform light");
    }

    #[test]
    fn stated_layouts_are_believed() {
        use EnvironmentMap::{Cube, LatitudeLongitude};
        assert_eq!(check_layout(8, 8, Some(LatitudeLongitude)), Ok(()));
        let cube = check_layout(16, 8, Some(Cube)).unwrap_err().to_string();
        assert!(cube.contains("envmap") && cube.contains("exrenvmap"), "{cube}");
        assert_eq!(check_layout(16, 8, None), Ok(()), "the control");
    }

    #[test]
    fn centre_is_plus_x_and_left_quarter_is_plus_y() {
        use glam::DVec3;
        let at = |column: usize| {
            let mut texels = vec![[0.0; 3]; 16 * 8];
            for row in 3..5 {
                texels[16 * row + column - 1] = [1.0; 3];
                texels[16 * row + column] = [1.0; 3];
            }
            decode(&exr_image::encode_rgb(16, 8, &texels).unwrap()).unwrap().map
        };
        let lights = |map: &EnvMap| [DVec3::X, DVec3::Y, -DVec3::Y].map(|d| map.sample(d)[0] > 0.9);
        assert_eq!(lights(&at(8)), [true, false, false], "the centre");
        assert_eq!(lights(&at(4)), [false, true, false], "a quarter from the left");
        assert_eq!(lights(&at(12)), [false, false, true], "a quarter from the right");
        let turned = at(8).rotated_and_scaled(90.0, 1.0);
        assert_eq!(lights(&turned), [false, true, false], "a rotation of 90 degrees moves +X to +Y");
    }

    fn seeds() -> Vec<Vec<u8>> {
        let mut columns =
            b"#?RGBE\r\nEXPOSURE=2\r\nPRIMARIES=.7 .3 .2 .8 .1 .1 .3 .3\r\n\r\n+X 16 -Y 8\r\n".to_vec();
        columns.extend([128, 64, 32, 129].repeat(128));
        vec![encode_exr(&example()).unwrap(), encode_hdr(&example()).unwrap(), columns]
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: cases_or(300), failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn changed_environment_files_cause_no_panic(
            which in 0usize..3,
            changes in prop::collection::vec((any::<usize>(), any::<u8>()), 1..8),
        ) {
            let mut bytes = seeds()[which].clone();
            for (at, value) in changes {
                // Most changes are in the header.
                let near = if at % 2 == 0 { bytes.len().min(400) } else { bytes.len() };
                bytes[at / 2 % near] = value;
            }
            // As in the server, files that would take too much memory are not decoded.
            if decoding_bytes(&bytes).is_ok_and(|count| count < 1 << 24) {
                let _ = decode(&bytes);
            }
        }
    }
}
