//! The colour space that an image file states.

use image::ImageFormat;

use super::png_chunks;
use crate::formats::exif_data;

/// The colour space that an image file states.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::formats) enum StatedColour {
    /// An ICC profile.
    Icc(Vec<u8>),
    /// Colour primaries and transfer function as codes of ITU-T H.273 (cICP in PNG, nclx in HEIC and AVIF).
    Coded { primaries: u8, transfer: u8 },
    /// Chunks gAMA and cHRM of a PNG.
    Measured {
        /// Exponent of the encoding, light to value; `None` for the sRGB curve.
        gamma: Option<f64>,
        /// CIE x and y of white, red, green and blue; `None` for those of sRGB.
        chromaticities: Option<[[f64; 2]; 4]>,
    },
    /// Adobe RGB by the interoperability index R03 of EXIF, which cameras write instead of a profile.
    AdobeRgb,
}

impl StatedColour {
    /// The colour space of a file with the ICC profile `icc`; `None` if it states none, or sRGB.
    pub(in crate::formats) fn of_file(
        bytes: &[u8],
        format: ImageFormat,
        icc: Option<Vec<u8>>,
    ) -> Option<Self> {
        if format == ImageFormat::Png {
            return Self::of_png(bytes, icc);
        }
        let stated = icc.filter(|icc| !icc.is_empty()).map(Self::Icc);
        stated.or_else(|| exif_data::is_adobe_rgb(bytes).then_some(Self::AdobeRgb))
    }

    /// The chunks of a PNG in their order of precedence: cICP, iCCP, sRGB, gAMA and cHRM.
    fn of_png(bytes: &[u8], icc: Option<Vec<u8>>) -> Option<Self> {
        let chunks = png_chunks::read(bytes);
        if let Some([primaries, transfer]) = chunks.cicp {
            return Some(Self::Coded { primaries, transfer });
        }
        if let Some(icc) = icc.filter(|icc| !icc.is_empty()) {
            return Some(Self::Icc(icc));
        }
        // Encoders write the gamma of sRGB as 0.45455 or 0.4545.
        let gamma = chunks.gamma.filter(|gamma| !((gamma - 0.454_55).abs() < 0.002));
        let is_stated = !chunks.is_srgb && (gamma.is_some() || chunks.chromaticities.is_some());
        is_stated.then_some(Self::Measured { gamma, chromaticities: chunks.chromaticities })
    }
}
