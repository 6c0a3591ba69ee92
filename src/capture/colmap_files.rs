//! The three files of a COLMAP model, binary and text, read without trusting a single count.

use std::collections::BTreeMap;

use glam::{DQuat, DVec3};

use crate::capture::lens::{Distortion, Lens};
use crate::capture::{CaptureError, Source};
use crate::formats::ply_points::Point;
use crate::formats::srgb;

/// A sparse model as stored: world-to-camera poses, OpenCV axes, COLMAP's own world.
#[derive(Debug, Default)]
pub(super) struct Model {
    /// Lenses by camera id.
    pub lenses: BTreeMap<u32, Lens>,
    /// Images in file order.
    pub images: Vec<PosedImage>,
    /// Points with linear colours.
    pub points: Vec<Point>,
}

/// One registered image.
#[derive(Debug, Clone)]
pub(super) struct PosedImage {
    /// Path below the image folder.
    pub name: String,
    /// Camera id.
    pub camera: u32,
    /// World-to-camera rotation, unit.
    pub rotation: DQuat,
    /// World-to-camera translation.
    pub translation: DVec3,
}

/// Reads `cameras`, `images` and, if it is there, `points3D` from `folder`.
///
/// # Errors
/// Names the file, and the entry where a value is unusable.
pub(super) fn read(source: &Source, folder: &str, ending: &str) -> Result<Model, CaptureError> {
    let file = |name: &str| format!("{folder}{name}{ending}");
    let (cameras, images, points) = (file("cameras"), file("images"), file("points3D"));
    let mut model = Model::default();
    let (camera_bytes, image_bytes) = (source.read(&cameras)?, source.read(&images)?);
    let point_bytes = if source.contains(&points) { Some(source.read(&points)?) } else { None };
    let limits = source.limits();
    if ending == ".bin" {
        model.lenses = binary_cameras(Bytes::new(&cameras, &camera_bytes))?;
        model.images = binary_images(Bytes::new(&images, &image_bytes), limits.max_images)?;
        if let Some(bytes) = &point_bytes {
            model.points = binary_points(Bytes::new(&points, bytes), limits.max_points)?;
        }
    } else {
        model.lenses = text_cameras(&Text::new(&cameras, &camera_bytes)?)?;
        model.images = text_images(&Text::new(&images, &image_bytes)?, limits.max_images)?;
        if let Some(bytes) = &point_bytes {
            model.points = text_points(&Text::new(&points, bytes)?, limits.max_points)?;
        }
    }
    Ok(model)
}

fn bad(file: &str, field: impl Into<String>, reason: impl Into<String>) -> CaptureError {
    CaptureError::Field { file: file.to_owned(), field: field.into(), reason: reason.into() }
}

/// Name and number of parameters of the camera models that can be undistorted, by COLMAP's id.
const CAMERA_MODELS: [(&str, usize); 6] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
];

/// A lens from a model's name, image size and parameters.
fn lens(file: &str, id: u32, model: &str, size: (f64, f64), p: &[f64]) -> Result<Lens, CaptureError> {
    let field = |name: &str| format!("cameras[{id}].{name}");
    if !p.iter().all(|v| v.is_finite()) {
        return Err(bad(file, field("params"), "must be finite"));
    }
    let radial = |k1, k2| Distortion::RadialTangential { k: [k1, k2, 0.0, 0.0], p: [0.0; 2] };
    let (focal, centre, distortion) = match (model, p) {
        ("SIMPLE_PINHOLE", &[f, cx, cy]) => ([f, f], [cx, cy], Distortion::None),
        ("PINHOLE", &[fx, fy, cx, cy]) => ([fx, fy], [cx, cy], Distortion::None),
        ("SIMPLE_RADIAL", &[f, cx, cy, k]) => ([f, f], [cx, cy], radial(k, 0.0)),
        ("RADIAL", &[f, cx, cy, k1, k2]) => ([f, f], [cx, cy], radial(k1, k2)),
        ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => {
            let lens = Distortion::RadialTangential { k: [k1, k2, 0.0, 0.0], p: [p1, p2] };
            ([fx, fy], [cx, cy], lens)
        }
        ("OPENCV_FISHEYE", &[fx, fy, cx, cy, k1, k2, k3, k4]) => {
            ([fx, fy], [cx, cy], Distortion::Fisheye { k: [k1, k2, k3, k4] })
        }
        _ => {
            let known = CAMERA_MODELS.map(|(name, count)| format!("{name} ({count})")).join(", ");
            let reason = format!("{model} with {} parameters is not supported; these are: {known}", p.len());
            return Err(bad(file, field("model"), reason));
        }
    };
    Ok(Lens {
        size: Some(size),
        focal: focal.map(Some),
        angle: [None; 2],
        centre: centre.map(Some),
        distortion: distortion.simplified(),
    })
}

/// Checks a pose: quaternion w x y z and translation, world-to-camera.
fn posed(
    file: &str,
    name: String,
    camera: u32,
    q: [f64; 4],
    t: [f64; 3],
) -> Result<PosedImage, CaptureError> {
    let rotation = DQuat::from_xyzw(q[1], q[2], q[3], q[0]);
    let length = rotation.length();
    if !(length.is_finite() && length > 1e-6) {
        return Err(bad(file, format!("images[{name}].qvec"), "is no rotation"));
    }
    let translation = DVec3::from(t);
    if !translation.is_finite() {
        return Err(bad(file, format!("images[{name}].tvec"), "has a value that is not finite"));
    }
    Ok(PosedImage { name, camera, rotation: rotation.normalize(), translation })
}

fn coloured(file: &str, index: usize, position: DVec3, colour: [u8; 3]) -> Result<Point, CaptureError> {
    if !position.is_finite() {
        return Err(bad(file, format!("points3D[{index}].xyz"), "has a value that is not finite"));
    }
    Ok((position, colour.map(|c| srgb::decode(f32::from(c) / 255.0))))
}

fn check_count(file: &str, limit: &'static str, count: usize, allowed: usize) -> Result<(), CaptureError> {
    if count <= allowed {
        return Ok(());
    }
    Err(CaptureError::OverLimit {
        file: file.to_owned(),
        limit,
        reason: format!("{count}, {allowed} allowed"),
    })
}

/// A little-endian reader that refuses to run past the end.
struct Bytes<'a> {
    file: &'a str,
    rest: &'a [u8],
    length: usize,
}

impl<'a> Bytes<'a> {
    fn new(file: &'a str, bytes: &'a [u8]) -> Self {
        Self { file, rest: bytes, length: bytes.len() }
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], CaptureError> {
        let (head, rest) = self.rest.split_first_chunk::<N>().ok_or_else(|| self.cut_short())?;
        self.rest = rest;
        Ok(*head)
    }

    fn cut_short(&self) -> CaptureError {
        let reason = format!("is cut short at byte {} of {}", self.length - self.rest.len(), self.length);
        CaptureError::File { file: self.file.to_owned(), reason }
    }

    fn u32(&mut self) -> Result<u32, CaptureError> {
        self.array().map(u32::from_le_bytes)
    }

    fn floats<const N: usize>(&mut self) -> Result<[f64; N], CaptureError> {
        let mut out = [0.0; N];
        for value in &mut out {
            *value = f64::from_le_bytes(self.array()?);
        }
        Ok(out)
    }

    /// A count of things of at least `size` bytes each, checked against what is left.
    fn count(&mut self, size: usize) -> Result<usize, CaptureError> {
        let count = u64::from_le_bytes(self.array()?);
        let fits =
            usize::try_from(count).ok().filter(|n| n.checked_mul(size).is_some_and(|b| b <= self.rest.len()));
        fits.ok_or_else(|| CaptureError::File {
            file: self.file.to_owned(),
            reason: format!("claims {count} entries, more than its {} bytes can hold", self.length),
        })
    }

    fn skip(&mut self, bytes: usize) -> Result<(), CaptureError> {
        self.rest = self.rest.get(bytes..).ok_or_else(|| self.cut_short())?;
        Ok(())
    }

    /// A NUL-terminated path inside the capture.
    fn name(&mut self) -> Result<String, CaptureError> {
        const LONGEST: usize = 1024;
        let end = self.rest.iter().take(LONGEST).position(|&b| b == 0).ok_or_else(|| self.cut_short())?;
        let name = String::from_utf8_lossy(&self.rest[..end]).into_owned();
        self.rest = &self.rest[end + 1..];
        Ok(name)
    }
}

fn binary_cameras(mut bytes: Bytes<'_>) -> Result<BTreeMap<u32, Lens>, CaptureError> {
    let mut lenses = BTreeMap::new();
    for _ in 0..bytes.count(48)? {
        let (id, model) = (bytes.u32()?, bytes.u32()?);
        let size = [u64::from_le_bytes(bytes.array()?), u64::from_le_bytes(bytes.array()?)];
        let Some((name, count)) = CAMERA_MODELS.get(model as usize) else {
            // Its length is unknown, so nothing after it can be read either.
            return lens(bytes.file, id, &format!("model {model}"), (0.0, 0.0), &[]).map(|_| lenses);
        };
        let mut params = Vec::with_capacity(*count);
        for _ in 0..*count {
            params.extend(bytes.floats::<1>()?);
        }
        lenses.insert(id, lens(bytes.file, id, name, (size[0] as f64, size[1] as f64), &params)?);
    }
    Ok(lenses)
}

fn binary_images(mut bytes: Bytes<'_>, allowed: usize) -> Result<Vec<PosedImage>, CaptureError> {
    let count = bytes.count(73)?;
    check_count(bytes.file, "max_images", count, allowed)?;
    let mut images = Vec::with_capacity(count);
    for _ in 0..count {
        let _id = bytes.u32()?;
        let (q, t) = (bytes.floats()?, bytes.floats()?);
        let camera = bytes.u32()?;
        let name = bytes.name()?;
        let observations = bytes.count(24)?;
        bytes.skip(observations * 24)?;
        images.push(posed(bytes.file, name, camera, q, t)?);
    }
    Ok(images)
}

fn binary_points(mut bytes: Bytes<'_>, allowed: usize) -> Result<Vec<Point>, CaptureError> {
    let count = bytes.count(51)?;
    check_count(bytes.file, "max_points", count, allowed)?;
    let mut points = Vec::with_capacity(count);
    for index in 0..count {
        bytes.skip(8)?;
        let position = DVec3::from(bytes.floats()?);
        let colour = bytes.array()?;
        bytes.skip(8)?;
        let track = bytes.count(8)?;
        bytes.skip(track * 8)?;
        points.push(coloured(bytes.file, index, position, colour)?);
    }
    Ok(points)
}

/// A text file with its name for errors.
struct Text<'a> {
    file: &'a str,
    text: &'a str,
}

impl<'a> Text<'a> {
    fn new(file: &'a str, bytes: &'a [u8]) -> Result<Self, CaptureError> {
        let text = std::str::from_utf8(bytes)
            .map_err(|_| CaptureError::File { file: file.to_owned(), reason: "is not text".to_owned() })?;
        Ok(Self { file, text })
    }

    /// Line numbers from 1, without comments.
    fn lines(&self) -> impl Iterator<Item = (usize, &'a str)> {
        let numbered = self.text.lines().enumerate().map(|(i, l)| (i + 1, l.trim()));
        numbered.filter(|(_, l)| !l.starts_with('#'))
    }

    fn line_error(&self, line: usize, reason: &str) -> CaptureError {
        bad(self.file, format!("line {line}"), reason)
    }

    /// The words as numbers; none is left out.
    fn numbers<const N: usize>(&self, line: usize, words: &[&str]) -> Result<[f64; N], CaptureError> {
        let values: Option<Vec<f64>> = words.iter().take(N).map(|w| w.parse().ok()).collect();
        let array = values.and_then(|v| <[f64; N]>::try_from(v).ok());
        array.ok_or_else(|| self.line_error(line, &format!("does not have {N} numbers where they belong")))
    }

    fn id(&self, line: usize, word: Option<&&str>) -> Result<u32, CaptureError> {
        let id = word.and_then(|w| w.parse().ok());
        id.ok_or_else(|| self.line_error(line, "has no whole number where an id belongs"))
    }
}

fn text_cameras(text: &Text<'_>) -> Result<BTreeMap<u32, Lens>, CaptureError> {
    let mut lenses = BTreeMap::new();
    for (line, content) in text.lines().filter(|(_, l)| !l.is_empty()) {
        let words: Vec<&str> = content.split_whitespace().collect();
        let id = text.id(line, words.first())?;
        let model = words.get(1).ok_or_else(|| text.line_error(line, "has no camera model"))?;
        let [w, h] = text.numbers(line, words.get(2..).unwrap_or_default())?;
        let params: Option<Vec<f64>> = words[4..].iter().map(|w| w.parse().ok()).collect();
        let params = params.ok_or_else(|| text.line_error(line, "has a parameter that is no number"))?;
        lenses.insert(id, lens(text.file, id, model, (w, h), &params)?);
    }
    Ok(lenses)
}

fn text_images(text: &Text<'_>, allowed: usize) -> Result<Vec<PosedImage>, CaptureError> {
    let mut images = Vec::new();
    let mut lines = text.lines();
    while let Some((line, content)) = lines.next() {
        if content.is_empty() {
            continue;
        }
        let words: Vec<&str> = content.split_whitespace().collect();
        let [_id, qw, qx, qy, qz, tx, ty, tz] = text.numbers(line, &words)?;
        let camera = text.id(line, words.get(8))?;
        let name = words.get(9..).filter(|w| !w.is_empty()).map(|w| w.join(" "));
        let name = name.ok_or_else(|| text.line_error(line, "has no image name"))?;
        images.push(posed(text.file, name, camera, [qw, qx, qy, qz], [tx, ty, tz])?);
        check_count(text.file, "max_images", images.len(), allowed)?;
        // The second line holds the observations and may be empty.
        lines.next();
    }
    Ok(images)
}

fn text_points(text: &Text<'_>, allowed: usize) -> Result<Vec<Point>, CaptureError> {
    let mut points = Vec::new();
    for (line, content) in text.lines().filter(|(_, l)| !l.is_empty()) {
        let words: Vec<&str> = content.split_whitespace().take(7).collect();
        let [_id, x, y, z, r, g, b] = text.numbers(line, &words)?;
        let colour = [r, g, b].map(|c| c.clamp(0.0, 255.0) as u8);
        points.push(coloured(text.file, points.len(), DVec3::new(x, y, z), colour)?);
        check_count(text.file, "max_points", points.len(), allowed)?;
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERAS: &str =
        "# comment\n1 OPENCV 640 480 500 510 320 240 0.1 -0.05 0.001 0.002\n2 PINHOLE 64 48 50 51 32 24\n";
    const IMAGES: &str = "# two lines each\n1 1 0 0 0 0.5 0.25 2 1 a b.jpg\n1.0 2.0 -1 3.0 4.0 7\n\
        2 0.5 0.5 0.5 0.5 1 2 3 2 c.jpg\n\n";
    const POINTS: &str = "7 1 2 3 255 0 0 0.5 1 0 2 0\n8 -1 0 1 0 255 0 0.1\n";

    /// The text model above, as COLMAP writes it in binary.
    fn binary() -> [Vec<u8>; 3] {
        fn put(out: &mut Vec<u8>, values: &[f64]) {
            values.iter().for_each(|v| out.extend(v.to_le_bytes()));
        }
        let mut cameras = 2u64.to_le_bytes().to_vec();
        for (id, model, w, h, p) in [
            (1u32, 4u32, 640u64, 480u64, &[500., 510., 320., 240., 0.1, -0.05, 0.001, 0.002][..]),
            (2, 1, 64, 48, &[50., 51., 32., 24.]),
        ] {
            cameras.extend([id, model].map(u32::to_le_bytes).as_flattened());
            cameras.extend([w, h].map(u64::to_le_bytes).as_flattened());
            put(&mut cameras, p);
        }
        let mut images = 2u64.to_le_bytes().to_vec();
        for (id, pose, camera, name, observations) in [
            (1u32, [1., 0., 0., 0., 0.5, 0.25, 2.], 1u32, "a b.jpg", 2u64),
            (2, [0.5, 0.5, 0.5, 0.5, 1., 2., 3.], 2, "c.jpg", 0),
        ] {
            images.extend(id.to_le_bytes());
            put(&mut images, &pose);
            images.extend(camera.to_le_bytes());
            images.extend(name.bytes().chain([0]));
            images.extend(observations.to_le_bytes());
            images.extend(vec![7; 24 * observations as usize]);
        }
        let mut points = 2u64.to_le_bytes().to_vec();
        for (id, xyz, rgb, track) in
            [(7u64, [1., 2., 3.], [255u8, 0, 0], 2u64), (8, [-1., 0., 1.], [0, 255, 0], 0)]
        {
            points.extend(id.to_le_bytes());
            put(&mut points, &xyz);
            points.extend(rgb);
            put(&mut points, &[0.5]);
            points.extend(track.to_le_bytes());
            points.extend(vec![1; 8 * track as usize]);
        }
        [cameras, images, points]
    }

    fn read_binary([cameras, images, points]: &[Vec<u8>; 3]) -> Result<Model, CaptureError> {
        Ok(Model {
            lenses: binary_cameras(Bytes::new("cameras.bin", cameras))?,
            images: binary_images(Bytes::new("images.bin", images), 100)?,
            points: binary_points(Bytes::new("points3D.bin", points), 100)?,
        })
    }

    fn text<'a>(file: &'a str, content: &'a str) -> Text<'a> {
        Text { file, text: content }
    }

    #[test]
    fn text_and_binary_say_the_same() {
        let binary = read_binary(&binary()).unwrap();
        assert_eq!(text_cameras(&text("cameras.txt", CAMERAS)).unwrap(), binary.lenses);
        let images = text_images(&text("images.txt", IMAGES), 10).unwrap();
        assert_eq!(format!("{images:?}"), format!("{:?}", binary.images));
        assert_eq!(images[0].name, "a b.jpg");
        assert_eq!(text_points(&text("points3D.txt", POINTS), 10).unwrap(), binary.points);
    }

    #[test]
    fn counts_that_lie_are_refused_before_they_cost_anything() {
        for file in 0..3 {
            for count in [3u64, 1 << 20, u64::MAX] {
                let mut files = binary();
                files[file][..8].copy_from_slice(&count.to_le_bytes());
                let error = read_binary(&files).unwrap_err();
                assert_eq!(error.code(), "capture_file_invalid", "{error}");
            }
        }
    }

    #[test]
    fn every_cut_is_an_error_and_no_flipped_byte_panics() {
        for file in 0..3 {
            let whole = binary();
            for at in 0..whole[file].len() {
                let mut cut = whole.clone();
                cut[file].truncate(at);
                assert!(read_binary(&cut).is_err(), "file {file} cut at {at}");
                for flip in [0x01, 0x80, 0xff] {
                    let mut flipped = whole.clone();
                    flipped[file][at] ^= flip;
                    let _ = read_binary(&flipped);
                }
            }
        }
    }

    #[test]
    fn unusable_values_are_named() {
        let field = |e: CaptureError| e.field().unwrap().to_owned();
        let cameras =
            |from, to| text_cameras(&text("c", &CAMERAS.replace(from, to))).map_err(field).unwrap_err();
        assert_eq!(cameras("OPENCV", "FULL_OPENCV"), "cameras[1].model");
        assert_eq!(cameras("-0.05", "nan"), "cameras[1].params");
        assert_eq!(cameras("640 480", "640"), "cameras[1].model");
        let images =
            |from, to| text_images(&text("i", &IMAGES.replace(from, to)), 9).map_err(field).unwrap_err();
        assert_eq!(images("1 1 0 0 0 ", "1 0 0 0 0 "), "images[a b.jpg].qvec");
        assert_eq!(images("0.25", "inf"), "images[a b.jpg].tvec");
        assert_eq!(images("2 1 a b.jpg", "x"), "line 2");
        let points =
            |from, to| text_points(&text("p", &POINTS.replace(from, to)), 9).map_err(field).unwrap_err();
        assert_eq!(points("-1 0 1", "-1 NaN 1"), "points3D[1].xyz");
    }
}
