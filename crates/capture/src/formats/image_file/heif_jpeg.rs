//! HEIC and AVIF pictures as JPEG, for programs that do not read them.

use super::decode::decode_photograph;
use super::encode::encode_jpeg;
use super::header::check_size;
use crate::formats::colour::StatedColour;
use crate::formats::{ImageFileError, heif};
use relume_scene::srgb;

/// Quality of the JPEG, 1 to 100.
const QUALITY: u8 = 97;

/// A HEIC or AVIF picture as a JPEG, upright, with the camera data and the ICC profile of the file. A colour space that a JPEG
/// cannot state is converted to sRGB; camera data are lost then.
///
/// # Errors
/// [`ImageFileError`]; more than `max_pixels` is refused before anything is decoded.
pub(crate) fn heif_as_jpeg(bytes: &[u8], max_pixels: u64) -> Result<Vec<u8>, ImageFileError> {
    check_size(bytes, max_pixels)?;
    // Codes 1 of the primaries and 13 of the transfer function are those of sRGB; 2 is unspecified.
    match heif::header(bytes)?.colour {
        None | Some(StatedColour::Icc(_) | StatedColour::Coded { primaries: 1 | 2, .. }) => {
            heif::to_jpeg(bytes)
        }
        Some(_) => {
            let image = decode_photograph(bytes, max_pixels, |stored| stored)?.image;
            let pixels: Vec<[u8; 3]> =
                image.pixels.iter().map(|p| [0, 1, 2].map(|k| srgb::to_u8(p[k]))).collect();
            encode_jpeg(image.width, image.height, &pixels, QUALITY)
        }
    }
}
