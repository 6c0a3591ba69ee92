//! OpenEXR images as linear RGBA, for photographs and environment maps.

use std::io::Cursor;

use exr::meta::header::Header;
use exr::prelude::{AnyChannels, FlatSamples, Layer, MetaData, ReadChannels, ReadLayers, WritableImage};

use crate::formats::ImageFileError;

/// Greatest number of decoded bytes of one file, all parts and channels together.
const MAX_DECODED_BYTES: u64 = 4 << 30;

/// True when the bytes begin like an OpenEXR file.
pub fn is_exr(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01])
}

/// Width and height of the first part, from the header.
///
/// # Errors
/// [`ImageFileError::Damaged`] if the header cannot be read or names data that this reader does not support.
pub fn dimensions(bytes: &[u8]) -> Result<(u32, u32), ImageFileError> {
    let meta = checked_header(bytes)?;
    let Some(first) = meta.headers.first() else {
        return Err(ImageFileError::Damaged("it has no parts".to_owned()));
    };
    let side = |n: usize| u32::try_from(n).map_err(|_| ImageFileError::Damaged("is too large".into()));
    Ok((side(first.layer_size.x())?, side(first.layer_size.y())?))
}

/// Bytes of all parts and channels once they are decoded, from the header.
///
/// # Errors
/// As [`dimensions`].
pub fn decoded_bytes(bytes: &[u8]) -> Result<u64, ImageFileError> {
    Ok(checked_header(bytes)?.headers.iter().map(part_bytes).sum())
}

fn part_bytes(header: &Header) -> u64 {
    let pixels = header.layer_size.x() as u64 * header.layer_size.y() as u64;
    pixels.saturating_mul(4 * header.channels.list.len() as u64)
}

/// The header, after checking that this reader supports it and that its size is within bounds.
fn checked_header(bytes: &[u8]) -> Result<MetaData, ImageFileError> {
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(damaged)?;
    let refuse = |reason: &str| Err(ImageFileError::Damaged(reason.to_owned()));
    let mut decoded = 0u64;
    for header in &meta.headers {
        if header.deep {
            return refuse("deep EXR data is not supported");
        }
        if header.channels.list.iter().any(|c| (c.sampling.x(), c.sampling.y()) != (1, 1)) {
            return refuse("subsampled EXR channels are not supported");
        }
        decoded = decoded.saturating_add(part_bytes(header));
    }
    if decoded > MAX_DECODED_BYTES {
        return refuse("it decodes to more than 4 GiB");
    }
    Ok(meta)
}

/// The first part with `R G B` (or luminance `Y`), as `(width, height, pixels)`; absent alpha is 1.
///
/// # Errors
/// [`ImageFileError::Damaged`] when the file is corrupt or no part has colour.
pub fn decode_rgba(bytes: &[u8]) -> Result<(u32, u32, Vec<[f32; 4]>), ImageFileError> {
    dimensions(bytes)?;
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes()
        .from_buffered(Cursor::new(bytes))
        .map_err(damaged)?;
    let found = image.layer_data.iter().find_map(|layer| Some((layer, colour_channels(layer)?)));
    let (layer, [r, g, b, a]) =
        found.ok_or_else(|| ImageFileError::Damaged("no part has channels R, G, B or Y".into()))?;
    let [r, g, b] = [r, g, b].map(values);
    let opaque = vec![1.0; r.len()];
    let a = a.map_or(opaque, |c| values(Some(c)));
    let pixels = (0..r.len()).map(|i| [r[i], g[i], b[i], a[i]]).collect();
    Ok((layer.size.x() as u32, layer.size.y() as u32, pixels))
}

/// Red, green, blue (always present) and alpha (optional) of a part.
fn colour_channels(layer: &Layer<AnyChannels<FlatSamples>>) -> Option<[Option<&FlatSamples>; 4]> {
    let named = |name: &str| layer.channel_data.list.iter().find(|c| c.name.eq(name)).map(|c| &c.sample_data);
    let alpha = named("A");
    let rgb = [named("R"), named("G"), named("B")];
    if rgb.iter().all(Option::is_some) {
        return Some([rgb[0], rgb[1], rgb[2], alpha]);
    }
    let luminance = named("Y")?;
    Some([Some(luminance), Some(luminance), Some(luminance), alpha])
}

fn values(samples: Option<&FlatSamples>) -> Vec<f32> {
    samples.map(|s| s.values_as_f32().collect()).unwrap_or_default()
}

/// A single-part RGB EXR of f32 values, ZIP-compressed.
///
/// # Errors
/// [`ImageFileError::Encode`] when the pixels do not fit the size.
pub fn encode_rgb(width: usize, height: usize, pixels: &[[f32; 3]]) -> Result<Vec<u8>, ImageFileError> {
    if pixels.is_empty() || pixels.len() != width * height {
        return Err(ImageFileError::Encode(format!("{} pixels do not fill {width}x{height}", pixels.len())));
    }
    let pixel = |p: exr::math::Vec2<usize>| {
        let [r, g, b] = pixels[p.y() * width + p.x()];
        (r, g, b)
    };
    let mut out = Cursor::new(Vec::new());
    exr::prelude::Image::from_channels((width, height), exr::prelude::SpecificChannels::rgb(pixel))
        .write()
        .to_buffered(&mut out)
        .map_err(|e| ImageFileError::Encode(e.to_string()))?;
    Ok(out.into_inner())
}

fn damaged(error: exr::error::Error) -> ImageFileError {
    ImageFileError::Damaged(error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rgb_round_trips_exactly() {
        let pixels: Vec<[f32; 3]> = (0..6).map(|i| [i as f32 * 0.3, -0.5, 6e4]).collect();
        let (w, h, back) = decode_rgba(&encode_rgb(3, 2, &pixels).unwrap()).unwrap();
        assert_eq!((w, h), (3, 2));
        assert!(back.iter().zip(&pixels).all(|(a, b)| a[..3] == b[..] && a[3] == 1.0));
    }

    #[test]
    fn truncated_files_are_reported_as_damaged() {
        let bytes = encode_rgb(8, 8, &[[0.5; 3]; 64]).unwrap();
        for cut in [4, 20, bytes.len() / 2, bytes.len() - 1] {
            assert!(matches!(decode_rgba(&bytes[..cut]), Err(ImageFileError::Damaged(_))), "cut at {cut}");
        }
    }
}
