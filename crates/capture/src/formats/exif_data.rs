//! EXIF data of a photograph.

use std::io::Cursor;

use exif::{Exif, In, Reader, Tag, Value};

use super::heif;

/// EXIF data of a photograph; `None` where the camera stated nothing.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ExifData {
    /// Model of the camera.
    pub camera: Option<String>,
    /// Exposure time, seconds.
    pub exposure_s: Option<f64>,
    /// F-number.
    pub f_number: Option<f64>,
    /// Sensitivity, ISO.
    pub iso: Option<f64>,
    /// Focal length, millimetres.
    pub focal_mm: Option<f64>,
    /// True when the camera chose the white balance.
    pub auto_white_balance: Option<bool>,
    /// EXIF orientation of the picture, 1 to 8; 1 is upright.
    pub orientation: Option<u8>,
}

impl ExifData {
    /// Exposure by the camera's settings, stops; +1 doubles the brightness of a scene.
    pub fn exposure_ev(&self) -> Option<f64> {
        let (time, f_number) = (self.exposure_s?, self.f_number?);
        let ev = (time * self.iso? / (100.0 * f_number * f_number)).log2();
        ev.is_finite().then_some(ev)
    }
}

/// The EXIF data of a JPEG, PNG, WebP, TIFF or HEIC; empty if absent or unreadable. A HEIC picture has no orientation here: its
/// container states the rotation, and converters apply it.
pub fn read(bytes: &[u8]) -> ExifData {
    let Ok(exif) = Reader::new().read_from_container(&mut Cursor::new(bytes)) else {
        return ExifData::default();
    };
    let integer = |tag| exif.get_field(tag, In::PRIMARY)?.value.get_uint(0);
    ExifData {
        camera: text(&exif, Tag::Model),
        exposure_s: number(&exif, Tag::ExposureTime),
        f_number: number(&exif, Tag::FNumber),
        iso: number(&exif, Tag::PhotographicSensitivity),
        focal_mm: number(&exif, Tag::FocalLength),
        auto_white_balance: integer(Tag::WhiteBalance).map(|mode| mode == 0),
        orientation: integer(Tag::Orientation)
            .and_then(|turn| u8::try_from(turn).ok())
            .filter(|turn| (1..=8).contains(turn) && !heif::is_heif(bytes)),
    }
}

/// Whether the interoperability index is R03: the camera used Adobe RGB (Design rule for Camera File system 2.0).
pub(super) fn is_adobe_rgb(bytes: &[u8]) -> bool {
    let Ok(exif) = Reader::new().read_from_container(&mut Cursor::new(bytes)) else { return false };
    let index = exif.get_field(Tag::InteroperabilityIndex, In::PRIMARY).map(|field| &field.value);
    matches!(index, Some(Value::Ascii(lines)) if lines.first().is_some_and(|line| line.starts_with(b"R03")))
}

/// A number above zero.
fn number(exif: &Exif, tag: Tag) -> Option<f64> {
    let field = exif.get_field(tag, In::PRIMARY)?;
    let value = match &field.value {
        Value::Rational(values) => values.first()?.to_f64(),
        value => f64::from(value.get_uint(0)?),
    };
    (value.is_finite() && value > 0.0).then_some(value)
}

fn text(exif: &Exif, tag: Tag) -> Option<String> {
    let Value::Ascii(lines) = &exif.get_field(tag, In::PRIMARY)?.value else { return None };
    let text = String::from_utf8_lossy(lines.first()?).trim().to_owned();
    (!text.is_empty()).then_some(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tag, type, count, value.
    type Entry = (u16, u16, u32, Vec<u8>);

    /// A directory of a little-endian TIFF structure at position `at`, followed by the values that do not fit its
    /// entries.
    fn directory(at: usize, entries: &[Entry]) -> Vec<u8> {
        let mut out = (entries.len() as u16).to_le_bytes().to_vec();
        let data_at = at + 2 + entries.len() * 12 + 4;
        let mut data: Vec<u8> = Vec::new();
        for (tag, kind, count, value) in entries {
            out.extend([tag.to_le_bytes(), kind.to_le_bytes()].concat());
            out.extend(count.to_le_bytes());
            if value.len() <= 4 {
                out.extend(value.iter().chain(&[0; 4]).take(4));
            } else {
                out.extend(((data_at + data.len()) as u32).to_le_bytes());
                data.extend(value);
            }
        }
        out.extend([0; 4]);
        out.extend(data);
        out
    }

    /// A JPEG without pixels, with entries of the picture and of the camera.
    fn jpeg(picture: &[Entry], camera: &[Entry]) -> Vec<u8> {
        const START: usize = 8;
        let with_pointer = |at: usize| {
            let pointer = (0x8769, 4, 1, (at as u32).to_le_bytes().to_vec());
            directory(START, &[picture, &[pointer]].concat())
        };
        let camera_at = START + with_pointer(0).len();
        let directories = [with_pointer(camera_at), directory(camera_at, camera)].concat();
        let tiff = [b"II*\0\x08\0\0\0".as_slice(), &directories].concat();
        let length = ((tiff.len() + 8) as u16).to_be_bytes();
        [b"\xff\xd8\xff\xe1".as_slice(), &length, b"Exif\0\0", &tiff, b"\xff\xd9"].concat()
    }

    fn rational(numerator: u32, denominator: u32) -> Vec<u8> {
        [numerator.to_le_bytes(), denominator.to_le_bytes()].concat()
    }

    #[test]
    fn exif_camera_facts_are_read() {
        let picture = [(0x0110, 2, 8, b"Phone 9\0".to_vec()), (0x0112, 3, 1, vec![6, 0])];
        let camera = [
            (0x829a, 5, 1, rational(1, 125)),
            (0x829d, 5, 1, rational(18, 10)),
            (0x8827, 3, 1, vec![200, 0]),
            (0xa403, 3, 1, vec![0, 0]),
        ];
        let facts = read(&jpeg(&picture, &camera));
        assert_eq!((facts.camera.as_deref(), facts.orientation), (Some("Phone 9"), Some(6)));
        assert!((facts.exposure_s.unwrap() - 0.008).abs() < 1e-12);
        assert_eq!((facts.iso, facts.auto_white_balance, facts.focal_mm), (Some(200.0), Some(true), None));
        let twice = ExifData { exposure_s: Some(0.016), ..facts.clone() };
        assert!((twice.exposure_ev().unwrap() - facts.exposure_ev().unwrap() - 1.0).abs() < 1e-9, "a stop");
    }

    #[test]
    fn adobe_rgb_is_recognised_by_the_interoperability_index() {
        // The picture's directory has 18 bytes at 8, that of the camera 18 bytes after it.
        const INDEX_AT: u32 = 8 + 18 + 18;
        let with_index = |index: &[u8]| {
            let pointer = [(0xa005, 4, 1, INDEX_AT.to_le_bytes().to_vec())];
            let mut file = jpeg(&[], &pointer);
            file.truncate(file.len() - 2);
            file.extend(directory(0, &[(0x0001, 2, 4, index.to_vec())]));
            let length = (file.len() - 4) as u16;
            file[4..6].copy_from_slice(&length.to_be_bytes());
            [&file[..], b"\xff\xd9"].concat()
        };
        assert!(is_adobe_rgb(&with_index(b"R03\0")));
        assert!(!is_adobe_rgb(&with_index(b"R98\0")), "sRGB");
        assert!(!is_adobe_rgb(&jpeg(&[], &[])));
    }

    #[test]
    fn truncated_or_invalid_exif_gives_no_facts() {
        let whole = jpeg(&[(0x0112, 3, 1, vec![6, 0])], &[]);
        assert_eq!(read(&whole).orientation, Some(6));
        for length in 0..whole.len() {
            let cut = read(&whole[..length]);
            assert!(cut == ExifData::default() || cut == read(&whole), "{length}: {cut:?}");
        }
        assert_eq!(read(&whole[..20]), ExifData::default());
        assert_eq!(read(&jpeg(&[(0x0112, 3, 1, vec![9, 0])], &[])).orientation, None, "not an orientation");
        assert_eq!(read(&jpeg(&[], &[(0x829a, 5, 1, rational(1, 0))])).exposure_s, None, "not a number");
    }
}
