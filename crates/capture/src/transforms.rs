//! The `transforms*.json` files of NeRF-synthetic, TensoIR and nerfstudio: the same keys in three layouts.

use std::collections::BTreeSet;

use glam::{DMat4, DVec4};
use serde::Deserialize;

use crate::json::parse_json;
use crate::lens::{Distortion, Lens};
use crate::{CaptureError, CaptureFiles, ImportLimits};

/// A parsed `transforms*.json`.
#[derive(Debug)]
pub(super) struct Transforms {
    /// The file's path in the capture.
    pub file: String,
    /// One entry per photograph.
    pub frames: Vec<TransformsFrame>,
    /// Path of a point cloud, if the file names one.
    pub points: Option<String>,
    /// The `file_path`s that the file itself holds out.
    pub held_out: BTreeSet<String>,
}

/// One frame: names, pose and lens.
#[derive(Debug)]
pub(super) struct TransformsFrame {
    /// The frame as errors name it, e.g. `frames[3]`.
    pub field: String,
    /// `file_path` without a leading `./`.
    pub path: String,
    /// `mask_path` without a leading `./`.
    pub mask: Option<String>,
    /// Camera-to-world, OpenGL axes.
    pub pose: DMat4,
    /// Intrinsics: the frame's own fields, else the file's.
    pub lens: Lens,
    /// Rotation of the light about +Z, degrees counter-clockwise; 0 if the frame states none.
    pub light_rotation_deg: f64,
}

/// Intrinsics that both a file and a frame may state. Unknown keys (`sharpness`, `rotation`) are ignored.
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
    light_rotation_deg: Option<f64>,
    #[serde(flatten)]
    lens: RawLens,
}

#[derive(Debug, Deserialize)]
struct RawTransforms {
    frames: Option<Vec<RawFrame>>,
    ply_file_path: Option<String>,
    #[serde(default)]
    test_filenames: Vec<String>,
    #[serde(flatten)]
    lens: RawLens,
}

/// Reads and checks `file`.
///
/// # Errors
/// Names the file, and the field whose value is missing or unusable.
pub(super) fn read(source: &CaptureFiles, file: &str) -> Result<Transforms, CaptureError> {
    parse(file, &source.read(file)?, source.limits())
}

/// Reads and checks the text of `file`.
///
/// # Errors
/// As [`read`].
pub(super) fn parse(file: &str, bytes: &[u8], limits: &ImportLimits) -> Result<Transforms, CaptureError> {
    let raw: RawTransforms = parse_json(file, bytes)?;
    let bad = |field: String, reason: &str| CaptureError::at_field(file, field, reason);
    let inside = |field: String, path: &str| {
        relative(path).ok_or_else(|| bad(field, "must be a path inside the capture"))
    };
    let frames = raw.frames.ok_or_else(|| bad("frames".into(), "is missing"))?;
    if frames.len() > limits.max_images {
        let reason = format!("{} frames, {} allowed", frames.len(), limits.max_images);
        return Err(CaptureError::over_limit(file, "max_images", reason));
    }
    let check = |(i, frame): (usize, RawFrame)| {
        let field = format!("frames[{i}]");
        let path = frame.file_path.ok_or_else(|| bad(format!("{field}.file_path"), "is missing"))?;
        let path = inside(format!("{field}.file_path"), &path)?;
        let mask = frame.mask_path.as_deref().map(|m| inside(format!("{field}.mask_path"), m));
        let pose = frame.transform_matrix.and_then(|rows| matrix(&rows));
        let reason = "must be a 4x4 matrix of finite numbers";
        let pose = pose.ok_or_else(|| bad(format!("{field}.transform_matrix"), reason))?;
        let lens = lens(&frame.lens.or(&raw.lens)).map_err(|(f, r)| bad(format!("{field}.{f}"), &r))?;
        let light_rotation_deg = frame.light_rotation_deg.unwrap_or(0.0);
        if !light_rotation_deg.is_finite() {
            return Err(bad(format!("{field}.light_rotation_deg"), "must be finite"));
        }
        Ok(TransformsFrame { field, path, mask: mask.transpose()?, pose, lens, light_rotation_deg })
    };
    let frames = frames.into_iter().enumerate().map(check).collect::<Result<_, _>>()?;
    let points = raw.ply_file_path.map(|p| inside("ply_file_path".into(), &p));
    let held_out = raw.test_filenames.iter().filter_map(|p| relative(p)).collect();
    Ok(Transforms { file: file.to_owned(), frames, points: points.transpose()?, held_out })
}

/// A path inside the capture, `/` between parts; `None` if it leaves the capture.
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
    /// Takes each field from `self`. Fields that `self` does not have come from `shared`.
    fn or(&self, shared: &Self) -> Self {
        macro_rules! each {
            ($($field:ident)*) => {
                Self { $($field: self.$field.clone().or_else(|| shared.$field.clone())),* }
            };
        }
        each!(camera_angle_x camera_angle_y fl_x fl_y cx cy w h k1 k2 k3 k4 p1 p2 camera_model is_fisheye)
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
                format!("{other:?} is not supported; use OPENCV or OPENCV_FISHEYE"),
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
    fn paths_are_normalised_and_escaping_paths_are_refused() {
        assert_eq!(relative("./a/../b/c.png").as_deref(), Some("b/c.png"));
        assert_eq!(relative("images\\1.jpg").as_deref(), Some("images/1.jpg"));
        for out in ["../x", "/etc/x", "a/../../x", "", "."] {
            assert_eq!(relative(out), None, "{out}");
        }
    }

    #[test]
    fn matrix_of_wrong_shape_or_last_row_is_refused() {
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
