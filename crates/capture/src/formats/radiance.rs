//! Radiance pictures (`.hdr`, `.pic`) as linear Rec.709.
//!
//! The header follows "The RADIANCE Picture File Format" (G. Ward, Radiance reference, `filefmts.pdf`). Several programs
//! write other first lines (`#?RGBE`), line ends with CR LF, and other orientations. This module reads the header, and
//! passes the scanlines behind a canonical header to the decoder of the `image` crate.

use std::io::{Cursor, Read};

use image::ImageDecoder;
use image::codecs::hdr::HdrDecoder;

use crate::formats::ImageFileError;
use crate::formats::chromaticities::ToRec709;

/// Longest accepted header, bytes.
const MAX_HEADER: usize = 1 << 16;
/// Greatest number of notes on ignored lines.
const MAX_NOTES: usize = 8;

/// A picture read from a file.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RadiancePicture {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Row-major linear Rec.709 radiance, top row first.
    pub texels: Vec<[f32; 3]>,
    /// Corrections that the header requires.
    pub notes: Vec<String>,
}

/// The header of a picture.
#[derive(Debug, Clone, PartialEq)]
struct RadianceHeader {
    scan: ScanOrder,
    /// Products of the `EXPOSURE` and `COLORCORR` lines, by which the radiances were multiplied.
    gain: [f64; 3],
    /// Conversion from the stated primaries.
    conversion: Option<ToRec709>,
    notes: Vec<String>,
    /// Length of the header, bytes, with the line of the resolution.
    length: usize,
}

/// Number, length and direction of the scanlines.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct ScanOrder {
    lines: u32,
    line_length: u32,
    /// True if scanlines are columns.
    columns: bool,
    /// True if the first scanline is the bottom row or the right column.
    lines_reversed: bool,
    /// True if scanlines run from right to left or upwards.
    line_reversed: bool,
}

impl ScanOrder {
    /// Width and height of the picture.
    fn size(&self) -> (u32, u32) {
        if self.columns { (self.lines, self.line_length) } else { (self.line_length, self.lines) }
    }

    /// Index in the file of the pixel in column `x` and row `y`.
    fn index(&self, x: usize, y: usize) -> usize {
        let (lines, line_length) = (self.lines as usize, self.line_length as usize);
        let (line, place) = if self.columns { (x, y) } else { (y, x) };
        let line = if self.lines_reversed { lines - 1 - line } else { line };
        let place = if self.line_reversed { line_length - 1 - place } else { place };
        line * line_length + place
    }
}

/// True when the bytes begin like a Radiance picture.
pub(super) fn is_radiance(bytes: &[u8]) -> bool {
    bytes.starts_with(b"#?")
}

/// Width and height, from the header.
///
/// # Errors
/// As [`decode`], for what the header shows.
pub(super) fn dimensions(bytes: &[u8]) -> Result<(u32, u32), ImageFileError> {
    Ok(header(bytes)?.scan.size())
}

/// Reads a picture. The caller checks its size with [`dimensions`] first. Values are divided by `EXPOSURE` and
/// `COLORCORR`, and converted from `PRIMARIES` to Rec.709.
///
/// # Errors
/// [`ImageFileError::Damaged`] for truncated and corrupt files, [`ImageFileError::Unsupported`] names the line of the
/// header that this reader does not support.
pub(super) fn decode(bytes: &[u8]) -> Result<RadiancePicture, ImageFileError> {
    let RadianceHeader { scan, gain, conversion, notes, length } = header(bytes)?;
    let canonical =
        format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {} +X {}\n", scan.lines, scan.line_length);
    let file = Cursor::new(canonical.as_bytes()).chain(bytes.get(length..).unwrap_or_default());
    let decoder = HdrDecoder::new(file).map_err(damaged)?;
    let mut raw = vec![0u8; decoder.total_bytes() as usize];
    decoder.read_image(&mut raw).map_err(damaged)?;
    let (stored, _) = raw.as_chunks::<12>();
    let texel = |x: usize, y: usize| -> [f32; 3] {
        let bytes = &stored[scan.index(x, y)];
        std::array::from_fn(|c| f32::from_ne_bytes(std::array::from_fn(|k| bytes[4 * c + k])))
    };
    let (width, height) = scan.size();
    let places = (0..height as usize).flat_map(|y| (0..width as usize).map(move |x| (x, y)));
    let mut texels: Vec<[f32; 3]> = places.map(|(x, y)| texel(x, y)).collect();
    if gain != [1.0; 3] {
        texels.iter_mut().for_each(|t| *t = std::array::from_fn(|c| (f64::from(t[c]) / gain[c]) as f32));
    }
    if let Some(conversion) = conversion {
        texels.iter_mut().for_each(|t| *t = conversion.apply(*t));
    }
    Ok(RadiancePicture { width, height, texels, notes })
}

fn header(bytes: &[u8]) -> Result<RadianceHeader, ImageFileError> {
    let window = &bytes[..bytes.len().min(MAX_HEADER)];
    let mut header = RadianceHeader {
        scan: ScanOrder {
            lines: 0,
            line_length: 0,
            columns: false,
            lines_reversed: false,
            line_reversed: false,
        },
        gain: [1.0; 3],
        conversion: None,
        notes: Vec::new(),
        length: 0,
    };
    // An empty line ends the variables; the next line states the resolution.
    let mut after_variables = false;
    while let Some(end) = window[header.length..].iter().position(|byte| *byte == b'\n') {
        let line = String::from_utf8_lossy(&window[header.length..header.length + end]);
        let line = line.trim_end_matches('\r');
        header.length += end + 1;
        if after_variables {
            header.scan = resolution(line)?;
            header.finish();
            return Ok(header);
        }
        after_variables = line.is_empty();
        header.read_variable(line)?;
    }
    Err(ImageFileError::Damaged("its header is truncated, or longer than 64 KiB".to_owned()))
}

impl RadianceHeader {
    /// Reads a line `NAME=VALUE`; other lines are comments and commands.
    fn read_variable(&mut self, line: &str) -> Result<(), ImageFileError> {
        let Some((name, value)) = line.split_once('=') else { return Ok(()) };
        let value = value.trim();
        match name.trim() {
            "FORMAT" if value == "32-bit_rle_xyze" => Err(unsupported(
                line,
                "stores CIE XYZ; convert it to RGB, e.g. `ra_xyze -r in.hdr out.hdr` of Radiance",
            )),
            "FORMAT" if value != "32-bit_rle_rgbe" => {
                Err(unsupported(line, "is not a format of Radiance pictures"))
            }
            "EXPOSURE" => {
                self.multiply(line, value, 1);
                Ok(())
            }
            "COLORCORR" => {
                self.multiply(line, value, 3);
                Ok(())
            }
            "PRIMARIES" => self.read_primaries(line, value),
            "GAMMA" if value.parse() != Ok(1.0) => {
                self.notes
                    .push(format!("the line {} was ignored; Radiance pictures are linear", quoted(line)));
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// Multiplies the gain by the numbers of a line: one for all channels, or one for each. An unusable line is ignored with a
    /// note; so is one that makes the gain 0 or infinite.
    fn multiply(&mut self, line: &str, value: &str, count: usize) {
        let factors = numbers(value).filter(|factors| factors.len() == count);
        let product = factors.map(|factors| std::array::from_fn(|c| self.gain[c] * factors[c % count]));
        match product.filter(|gain: &[f64; 3]| gain.iter().all(|gain| *gain > 0.0 && gain.is_finite())) {
            Some(gain) => self.gain = gain,
            None if self.notes.len() < MAX_NOTES => self.notes.push(format!(
                "the line {} was ignored: it must have {count} number(s) above 0",
                quoted(line)
            )),
            None => {}
        }
    }

    fn read_primaries(&mut self, line: &str, value: &str) -> Result<(), ImageFileError> {
        let stated = numbers(value).and_then(|n| <[f64; 8]>::try_from(n).ok());
        let Some(stated) = stated else { return Err(unsupported(line, "must have 8 numbers")) };
        // Photoshop writes zeros.
        if stated == [0.0; 8] {
            return Ok(());
        }
        let pair = |k: usize| [stated[2 * k] as f32, stated[2 * k + 1] as f32];
        let Ok(conversion) = ToRec709::of([pair(0), pair(1), pair(2), pair(3)]) else {
            return Err(unsupported(line, "defines no colours"));
        };
        self.conversion = conversion;
        Ok(())
    }

    /// Adds the notes on gain and primaries.
    fn finish(&mut self) {
        if self.gain != [1.0; 3] {
            let [r, g, b] = self.gain;
            let by = if r == g && g == b { format!("{r}") } else { format!("{r}, {g}, {b}") };
            self.notes
                .push(format!("the values were divided by EXPOSURE and COLORCORR of the header ({by})"));
        }
        if let Some(conversion) = self.conversion {
            let name = conversion.name;
            self.notes.push(format!("the colours were converted from {name} to Rec.709 (line PRIMARIES)"));
        }
    }
}

/// The line of the resolution, e.g. `-Y 512 +X 1024`: the axis from scanline to scanline, then the axis along them. `-Y`
/// runs downwards.
fn resolution(line: &str) -> Result<ScanOrder, ImageFileError> {
    let malformed = || unsupported(line, "is not a resolution like `-Y 512 +X 1024`");
    let words: Vec<&str> = line.split_whitespace().collect();
    let [first, lines, second, line_length] = words[..] else { return Err(malformed()) };
    let count = |text: &str| text.parse().ok().filter(|n: &u32| *n > 0).ok_or_else(malformed);
    // Rows start at the top with -Y, columns at the left with +X.
    let is_reversed = |axis: &str| axis == "+Y" || axis == "-X";
    let (is_row, is_column) = (|axis: &str| axis.ends_with('Y'), |axis: &str| axis.ends_with('X'));
    let is_axis = |axis: &str| ["+X", "-X", "+Y", "-Y"].contains(&axis);
    if !(is_axis(first) && is_axis(second) && is_row(first) == is_column(second)) {
        return Err(malformed());
    }
    Ok(ScanOrder {
        lines: count(lines)?,
        line_length: count(line_length)?,
        columns: is_column(first),
        lines_reversed: is_reversed(first),
        line_reversed: is_reversed(second),
    })
}

fn numbers(text: &str) -> Option<Vec<f64>> {
    text.split_whitespace().map(|word| word.parse().ok()).collect()
}

fn quoted(line: &str) -> String {
    format!("{:?}", line.chars().take(60).collect::<String>())
}

fn unsupported(line: &str, reason: &str) -> ImageFileError {
    ImageFileError::Unsupported(format!("the line {} of the header {reason}", quoted(line)))
}

fn damaged(error: image::ImageError) -> ImageFileError {
    let is_end =
        matches!(&error, image::ImageError::IoError(e) if e.kind() == std::io::ErrorKind::UnexpectedEof);
    ImageFileError::Damaged(if is_end { "its pixels are truncated".to_owned() } else { error.to_string() })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture of two rows of three pixels, the red channel counting from 1 in the order of the file.
    fn file(header: &str) -> Vec<u8> {
        let pixels = (1..=6u8).flat_map(|red| [red, 128, 64, 136]);
        header.bytes().chain(pixels).collect()
    }

    fn reds(bytes: &[u8]) -> (u32, u32, Vec<f32>) {
        let picture = decode(bytes).unwrap();
        (picture.width, picture.height, picture.texels.iter().map(|t| t[0]).collect())
    }

    fn refused(header: &str) -> String {
        decode(&file(header)).unwrap_err().to_string()
    }

    #[test]
    fn headers_of_other_programs_are_read() {
        let plain = decode(&file("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 3\n")).unwrap();
        assert_eq!((plain.texels[4], plain.notes.len()), ([5.0, 128.0, 64.0], 0));
        for header in [
            "#?RGBE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 3\n",
            "#?RADIANCE\r\n# made by hand\r\nFORMAT=32-bit_rle_rgbe\r\n\r\n-Y 2 +X 3\r\n",
            "#?RADIANCE\nSOFTWARE=x\n\n-Y 2 +X 3\n",
            "#?RADIANCE\nGAMMA=1\nPRIMARIES=0 0 0 0 0 0 0 0\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 3\n",
            "#?RADIANCE\nEXPOSURE=2.0\nEXPOSURE= 0.5\nPRIMARIES=.64 .33 .3 .6 .15 .06 .3127 .329\n\n-Y 2 +X 3\n",
        ] {
            assert_eq!(decode(&file(header)).unwrap(), plain, "{header}");
        }
    }

    #[test]
    fn all_scan_orders_give_the_upright_picture() {
        for (line, right) in [
            ("-Y 2 +X 3", (3, 2, [1, 2, 3, 4, 5, 6])),
            ("+Y 2 +X 3", (3, 2, [4, 5, 6, 1, 2, 3])),
            ("-Y 2 -X 3", (3, 2, [3, 2, 1, 6, 5, 4])),
            ("+X 2 -Y 3", (2, 3, [1, 4, 2, 5, 3, 6])),
            ("-X 2 -Y 3", (2, 3, [4, 1, 5, 2, 6, 3])),
            ("+X 2 +Y 3", (2, 3, [3, 6, 2, 5, 1, 4])),
        ] {
            let bytes = file(&format!("#?RADIANCE\n\n{line}\n"));
            let (width, height, values) = reds(&bytes);
            assert_eq!(dimensions(&bytes).unwrap(), (width, height));
            assert_eq!(
                (width, height, values),
                (right.0, right.1, right.2.map(|v| v as f32).to_vec()),
                "{line}"
            );
        }
    }

    #[test]
    fn exposure_and_primaries_are_taken_out() {
        let picture =
            decode(&file("#?RADIANCE\nEXPOSURE=4\nEXPOSURE=0.5\nCOLORCORR=1 2 4\n\n-Y 2 +X 3\n")).unwrap();
        assert_eq!(picture.texels[1], [1.0, 32.0, 8.0]);
        assert!(picture.notes[0].contains("EXPOSURE") && picture.notes[0].contains("2, 4, 8"));
        let wide = "#?RADIANCE\nPRIMARIES=.713 .293 .165 .83 .128 .044 .32168 .33767\n\n-Y 2 +X 3\n";
        let picture = decode(&file(wide)).unwrap();
        assert!(picture.notes[0].contains("ACEScg") && picture.texels[0] != [1.0, 128.0, 64.0]);
    }

    #[test]
    fn unusable_exposures_are_ignored_with_a_note() {
        let lines = [
            "EXPOSURE=0",
            "EXPOSURE=x",
            "EXPOSURE=-1",
            "EXPOSURE=inf",
            "EXPOSURE=nan",
            "EXPOSURE=",
            "COLORCORR=1 1",
            "COLORCORR=1 -1 -1",
        ];
        for line in lines {
            let header = format!("#?RADIANCE\nEXPOSURE=2\n{line}\n\n-Y 2 +X 3\n");
            let picture = decode(&file(&header)).unwrap();
            assert_eq!(picture.texels[1], [1.0, 64.0, 32.0], "{line}: the usable line remains");
            assert!(picture.notes[0].contains(line) && picture.notes[0].contains("ignored"), "{line}");
        }
        let tiny = "EXPOSURE=1e-200\n".repeat(2);
        let picture = decode(&file(&format!("#?RADIANCE\n{tiny}\n-Y 2 +X 3\n"))).unwrap();
        assert!(picture.notes[0].contains("ignored"), "a product of 0: {:?}", picture.notes);
        let many = "EXPOSURE=0\n".repeat(1000);
        let picture = decode(&file(&format!("#?RADIANCE\n{many}\n-Y 2 +X 3\n"))).unwrap();
        assert_eq!(picture.notes.len(), MAX_NOTES);
        let plain = decode(&file("#?RADIANCE\nEXPOSURE=1\n\n-Y 2 +X 3\n")).unwrap();
        assert_eq!(plain.notes, Vec::<String>::new(), "the control");
    }

    #[test]
    fn unsupported_lines_are_named() {
        let with = |line: &str| refused(&format!("#?RADIANCE\n{line}\n\n-Y 2 +X 3\n"));
        assert!(with("FORMAT=32-bit_rle_xyze").contains("CIE XYZ"));
        assert!(with("FORMAT=8-bit").contains("FORMAT=8-bit"));
        assert!(with("PRIMARIES=1 2 3").contains("8 numbers"));
        assert!(with("PRIMARIES=1 1 1 1 1 1 1 1").contains("defines no colours"));
        for line in ["-Y 2 +Y 3", "-Y 0 +X 3", "-Y 2", "-Y 99999999999 +X 3", "-Z 2 +X 3", ""] {
            assert!(refused(&format!("#?RADIANCE\n\n{line}\n")).contains("resolution"), "{line}");
        }
    }

    #[test]
    fn truncated_headers_and_pixels_are_refused() {
        let whole = file("#?RADIANCE\nEXPOSURE=2\n\n-Y 2 +X 3\n");
        assert!(decode(&whole).is_ok());
        for cut in 0..whole.len() {
            assert!(decode(&whole[..cut]).is_err(), "cut at {cut}");
        }
        let endless = [b"#?RADIANCE\n".to_vec(), vec![b'\n'.wrapping_add(50); 1 << 17]].concat();
        assert!(decode(&endless).is_err());
    }
}
