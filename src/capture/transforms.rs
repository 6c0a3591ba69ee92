//! The `transforms*.json` files of NeRF-synthetic, TensoIR and nerfstudio: one vocabulary, three layouts.

use glam::{DMat4, DVec4};
use serde::Deserialize;

use crate::capture::lens::{Distortion, Lens};
use crate::capture::{CaptureError, Source};

/// A parsed `transforms*.json`.
#[derive(Debug)]
pub(super) struct Transforms {
    /// The file's path in the capture.
    pub file: String,
    /// One entry a photograph.
    pub frames: Vec<Frame>,
    /// Path of a point cloud, if the file names one.
    pub points: Option<String>,
}

/// One frame: names, pose and lens.
#[derive(Debug)]
pub(super) struct Frame {
    /// The frame as errors name it, e.g. `frames[3]`.
    pub field: String,
    /// `file_path` without a leading `./`.
    pub path: String,
    /// `mask_path`, likewise.
    pub mask: Option<String>,
    /// Camera-to-world, OpenGL axes.
    pub pose: DMat4,
    /// Intrinsics: the frame's own fields before the file's.
    pub lens: Lens,
}

/// The intrinsics both a file and a frame may carry; unknown keys (`sharpness`, `rotation`) are ignored.
#[derive(Debug, Clone, Default, Deserialize)]
struct RawLens {
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
}

#[derive(Debug, Deserialize)]
struct RawFrame {
    file_path: Option<String>,
    mask_path: Option<String>,
    transform_matrix: Option<Vec<Vec<f64>>>,
    #[serde(flatten)]
    lens: RawLens,
}

#[derive(Debug, Deserialize)]
struct RawTransforms {
    frames: Option<Vec<RawFrame>>,
    ply_file_path: Option<String>,
    #[serde(flatten)]
    lens: RawLens,
}

/// Reads and checks `file`.
///
/// # Errors
/// Names the file, and the field where a value is missing or unusable.
pub(super) fn read(source: &Source, file: &str) -> Result<Transforms, CaptureError> {
    let bytes = source.read(file)?;
    let raw: RawTransforms = parse_json(file, &bytes)?;
    let bad = |field: String, reason: &str| CaptureError::Field {
        file: file.to_owned(),
        field,
        reason: reason.to_owned(),
    };
    let frames = raw.frames.ok_or_else(|| bad("frames".into(), "is missing"))?;
    if frames.len() > source.limits().max_images {
        let reason = format!("{} frames, {} allowed", frames.len(), source.limits().max_images);
        return Err(CaptureError::OverLimit { file: file.to_owned(), limit: "max_images", reason });
    }
    let check = |(i, frame): (usize, RawFrame)| {
        let field = format!("frames[{i}]");
        let path = frame.file_path.ok_or_else(|| bad(format!("{field}.file_path"), "is missing"))?;
        let path =
            relative(&path).ok_or_else(|| bad(format!("{field}.file_path"), "leads out of the capture"))?;
        let mask = frame.mask_path.as_deref().map(|m| {
            relative(m).ok_or_else(|| bad(format!("{field}.mask_path"), "leads out of the capture"))
        });
        let pose = frame.transform_matrix.and_then(|rows| matrix(&rows));
        let reason = "must be a 4x4 matrix of finite numbers";
        let pose = pose.ok_or_else(|| bad(format!("{field}.transform_matrix"), reason))?;
        let lens = lens(&frame.lens.over(&raw.lens)).map_err(|(f, r)| bad(format!("{field}.{f}"), &r))?;
        Ok(Frame { field, path, mask: mask.transpose()?, pose, lens })
    };
    let frames = frames.into_iter().enumerate().map(check).collect::<Result<_, _>>()?;
    Ok(Transforms { file: file.to_owned(), frames, points: raw.ply_file_path })
}

/// Parses JSON so that a refusal names the file and, where it can be told, the key in front of the fault.
pub(super) fn parse_json<T: serde::de::DeserializeOwned>(
    file: &str,
    bytes: &[u8],
) -> Result<T, CaptureError> {
    serde_json::from_slice(bytes).map_err(|error| {
        let hint = match token_at(bytes, error.line(), error.column()) {
            Some(token) => {
                format!(" ({token} is not JSON; some tools write it for values that are not numbers)")
            }
            None => String::new(),
        };
        match key_before(bytes, error.line(), error.column()) {
            Some(field) => {
                CaptureError::Field { file: file.to_owned(), field, reason: format!("{error}{hint}") }
            }
            None => CaptureError::File {
                file: file.to_owned(),
                reason: format!("is not valid JSON: {error}{hint}"),
            },
        }
    })
}

/// Byte offset of a 1-based line and column.
fn offset(bytes: &[u8], line: usize, column: usize) -> usize {
    let before = bytes.split_inclusive(|&b| b == b'\n').take(line.saturating_sub(1));
    (before.map(<[u8]>::len).sum::<usize>() + column).min(bytes.len())
}

/// The last `"key":` before the place, read backwards.
fn key_before(bytes: &[u8], line: usize, column: usize) -> Option<String> {
    let text = String::from_utf8_lossy(&bytes[..offset(bytes, line, column)]);
    let colon = text.rfind(":")?;
    let end = text[..colon].rfind('"')?;
    let start = text[..end].rfind('"')?;
    let key = &text[start + 1..end];
    (!key.is_empty() && key.len() <= 64 && text[end + 1..colon].trim().is_empty()).then(|| key.to_owned())
}

/// A Python float literal that JSON has no word for, at the place.
fn token_at(bytes: &[u8], line: usize, column: usize) -> Option<&'static str> {
    let at = offset(bytes, line, column).saturating_sub(2);
    let rest = &bytes[at.min(bytes.len())..];
    ["NaN", "Infinity"]
        .into_iter()
        .find(|token| rest.windows(token.len()).take(3).any(|w| w == token.as_bytes()))
}

/// A path inside the capture, `/` between parts; nothing when it leads out.
pub(super) fn relative(path: &str) -> Option<String> {
    let path = path.replace('\\', "/");
    let mut parts = Vec::new();
    for part in path.split('/') {
        match part {
            "" | "." => {}
            ".." => drop(parts.pop()?),
            part => parts.push(part),
        }
    }
    (!path.starts_with('/') && !parts.is_empty()).then(|| parts.join("/"))
}

/// A 4x4 or 3x4 row-major matrix of finite numbers.
fn matrix(rows: &[Vec<f64>]) -> Option<DMat4> {
    let row = |i: usize| -> Option<DVec4> {
        let row: [f64; 4] = rows.get(i)?.as_slice().try_into().ok()?;
        row.iter().all(|v| v.is_finite()).then(|| DVec4::from(row))
    };
    let last = if rows.len() == 3 { DVec4::W } else { row(3)? };
    if rows.len() > 4 || last != DVec4::W {
        return None;
    }
    Some(DMat4::from_cols(row(0)?, row(1)?, row(2)?, last).transpose())
}

impl RawLens {
    /// These fields where they are given, `shared`'s elsewhere.
    fn over(&self, shared: &Self) -> Self {
        Self {
            camera_angle_x: self.camera_angle_x.or(shared.camera_angle_x),
            camera_angle_y: self.camera_angle_y.or(shared.camera_angle_y),
            fl_x: self.fl_x.or(shared.fl_x),
            fl_y: self.fl_y.or(shared.fl_y),
            cx: self.cx.or(shared.cx),
            cy: self.cy.or(shared.cy),
            w: self.w.or(shared.w),
            h: self.h.or(shared.h),
            k1: self.k1.or(shared.k1),
            k2: self.k2.or(shared.k2),
            k3: self.k3.or(shared.k3),
            k4: self.k4.or(shared.k4),
            p1: self.p1.or(shared.p1),
            p2: self.p2.or(shared.p2),
            camera_model: self.camera_model.clone().or_else(|| shared.camera_model.clone()),
            is_fisheye: self.is_fisheye.or(shared.is_fisheye),
        }
    }
}

fn lens(raw: &RawLens) -> Result<Lens, (&'static str, String)> {
    let number = |v: Option<f64>| v.unwrap_or(0.0);
    let k = [raw.k1, raw.k2, raw.k3, raw.k4].map(number);
    let p = [raw.p1, raw.p2].map(number);
    if !k.iter().chain(&p).all(|v| v.is_finite()) {
        return Err(("k1", "distortion must be finite".into()));
    }
    let fisheye = raw.is_fisheye.unwrap_or(false);
    let distortion = match raw.camera_model.as_deref() {
        Some("OPENCV_FISHEYE") => Distortion::Fisheye { k },
        None if fisheye => Distortion::Fisheye { k },
        None | Some("OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL" | "perspective") => {
            Distortion::RadialTangential { k, p }
        }
        Some(other) => {
            return Err((
                "camera_model",
                format!("{other:?} is not supported; OPENCV and OPENCV_FISHEYE are"),
            ));
        }
    };
    Ok(Lens {
        size: raw.w.zip(raw.h),
        focal: [raw.fl_x, raw.fl_y],
        angle: [raw.camera_angle_x, raw.camera_angle_y],
        centre: [raw.cx, raw.cy],
        distortion: distortion.simplified(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_normalised_and_kept_inside() {
        assert_eq!(relative("./a/../b/c.png").as_deref(), Some("b/c.png"));
        assert_eq!(relative("images\\1.jpg").as_deref(), Some("images/1.jpg"));
        for out in ["../x", "/etc/x", "a/../../x", "", "."] {
            assert_eq!(relative(out), None, "{out}");
        }
    }

    #[test]
    fn a_nan_literal_is_refused_by_key() {
        let text = b"{\n \"frames\": [ {\n  \"transform_matrix\": [[1.0, NaN, 0, 0]] } ] }";
        let error = parse_json::<RawTransforms>("transforms.json", text).unwrap_err();
        assert_eq!(error.file(), Some("transforms.json"));
        assert_eq!(error.field(), Some("transform_matrix"));
        assert!(error.to_string().contains("NaN"), "{error}");
    }

    #[test]
    fn a_matrix_needs_its_shape_and_its_last_row() {
        let row = |v: [f64; 4]| v.to_vec();
        let good =
            [row([1., 0., 0., 5.]), row([0., 1., 0., 6.]), row([0., 0., 1., 7.]), row([0., 0., 0., 1.])];
        assert_eq!(matrix(&good).unwrap().w_axis, DVec4::new(5., 6., 7., 1.));
        assert_eq!(matrix(&good), matrix(&good[..3]));
        assert_eq!(matrix(&good[..2]), None);
        let skewed = [good[0].clone(), good[1].clone(), good[2].clone(), row([0., 0., 0.5, 1.])];
        assert_eq!(matrix(&skewed), None);
        assert_eq!(matrix(&[vec![1.0; 3], vec![1.0; 3], vec![1.0; 3]]), None);
    }
}
