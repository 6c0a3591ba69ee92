//! The `transforms*.json` files of NeRF-synthetic, TensoIR and nerfstudio: the same keys in three layouts.

use std::collections::BTreeSet;

use glam::{DMat4, DVec4};
use serde_json::Value;

use crate::json::parse_json;
use crate::json_fields::Fields;
use crate::lens::Lens;
use crate::stated_lens::StatedLens;
use crate::text::fault_of_name;
use crate::{CaptureError, CaptureFiles, ImportLimits};
use relume_spec::training::{LIGHT_GROUP_NAME, is_light_group_name};

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
    /// Name of its light group, if the frame states one.
    pub light_group: Option<String>,
}

/// Largest size of the JSON, bytes: about twice that of [`ImportLimits::max_images`] frames. The parsed values take up to 16 times as
/// much memory.
const MAX_BYTES: usize = 32 << 20;

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
    if bytes.len() > MAX_BYTES {
        let reason = format!("has {} bytes; at most {MAX_BYTES} are read", bytes.len());
        return Err(CaptureError::File { file: file.to_owned(), reason });
    }
    let value: Value = parse_json(file, bytes)?;
    let set = Fields::new(file, "", &value)?;
    let frames = set.list("frames")?.ok_or_else(|| set.error("frames", "is missing"))?;
    if frames.len() > limits.max_images {
        let reason = format!("{} frames, {} allowed", frames.len(), limits.max_images);
        return Err(CaptureError::over_limit(file, "max_images", reason));
    }
    let shared = StatedLens::read(&set)?;
    let frames = frames.iter().enumerate().map(|(i, value)| {
        let field = format!("frames[{i}]");
        frame(&Fields::new(file, &field, value)?, &shared)
    });
    let frames = frames.collect::<Result<_, _>>()?;
    let points = set.text("ply_file_path")?;
    if let Some(fault) = points.and_then(fault_of_name) {
        return Err(set.error("ply_file_path", fault));
    }
    let points = points.map(str::to_owned);
    let names = |field: &str| -> Result<BTreeSet<String>, CaptureError> {
        let names = set.list(field)?.unwrap_or_default().iter().filter_map(Value::as_str);
        Ok(names.filter_map(relative).collect())
    };
    let test = names("test_filenames")?;
    let held_out = if test.is_empty() { names("val_filenames")? } else { test };
    Ok(Transforms { file: file.to_owned(), frames, points, held_out })
}

fn frame(fields: &Fields<'_>, shared: &StatedLens) -> Result<TransformsFrame, CaptureError> {
    let inside = |name: &str, path: &str| match fault_of_name(path) {
        Some(fault) => Err(fields.error(name, fault)),
        None => relative(path).ok_or_else(|| fields.error(name, "must be a path inside the capture")),
    };
    let path = fields.text("file_path")?.ok_or_else(|| fields.error("file_path", "is missing"))?;
    let path = inside("file_path", path)?;
    let mask = fields.text("mask_path")?.map(|mask| inside("mask_path", mask)).transpose()?;
    let rows = fields.rows("transform_matrix")?;
    let rows = rows.ok_or_else(|| fields.error("transform_matrix", "is missing"))?;
    let pose = matrix(&rows).map_err(|reason| fields.error("transform_matrix", reason))?;
    let lens =
        StatedLens::read(fields)?.or(shared).lens().map_err(|(name, reason)| fields.error(name, reason))?;
    let light_rotation_deg = fields.number("light_rotation_deg")?.unwrap_or(0.0);
    let light_group = fields.text("light_group")?;
    if light_group.is_some_and(|name| !is_light_group_name(name)) {
        return Err(fields.error("light_group", LIGHT_GROUP_NAME));
    }
    let light_group = light_group.map(str::to_owned);
    let field = fields.path.to_owned();
    Ok(TransformsFrame { field, path, mask, pose, lens, light_rotation_deg, light_group })
}

/// A path with `/` between parts, without the root of an absolute path; `None` if it leaves the capture by `..`.
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
    (!parts.is_empty()).then(|| parts.join("/"))
}

/// A 4x4 or 3x4 row-major matrix whose last row is `0 0 0 w`; it is divided by `w`.
fn matrix(rows: &[Vec<f64>]) -> Result<DMat4, &'static str> {
    const LAST: DVec4 = DVec4::W;
    /// Largest rounding error of a zero in the last row.
    const ROUNDING: f64 = 1e-6;
    let row = |i: usize| -> Option<DVec4> {
        let row: [f64; 4] = rows.get(i)?.as_slice().try_into().ok()?;
        Some(DVec4::from(row))
    };
    let last = if rows.len() == 3 { Some(LAST) } else { row(3).filter(|_| rows.len() == 4) };
    let (Some(x), Some(y), Some(z), Some(last)) = (row(0), row(1), row(2), last) else {
        return Err("must be a 4x4 or 3x4 matrix");
    };
    if last.w > 0.0 && last.truncate().abs().max_element() <= ROUNDING * last.w {
        return Ok(DMat4::from_cols(x / last.w, y / last.w, z / last.w, LAST).transpose());
    }
    if [x.w, y.w, z.w] == [0.0; 3] && last.w == 1.0 {
        return Err("the last row must be 0 0 0 1; the matrix looks transposed: write it by rows");
    }
    Err("the last row must be 0 0 0 1")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_normalised_and_escaping_paths_are_refused() {
        assert_eq!(relative("./a/../b/c.png").as_deref(), Some("b/c.png"));
        assert_eq!(relative("images\\1.jpg").as_deref(), Some("images/1.jpg"));
        assert_eq!(relative("/etc/x").as_deref(), Some("etc/x"), "a file of the capture, not of the machine");
        for out in ["../x", "a/../../x", "", "."] {
            assert_eq!(relative(out), None, "{out}");
        }
    }

    #[test]
    fn matrix_is_read_by_rows_and_divided_by_its_last_number() {
        let row = |v: [f64; 4]| v.to_vec();
        let good =
            [row([1., 0., 0., 5.]), row([0., 1., 0., 6.]), row([0., 0., 1., 7.]), row([0., 0., 0., 1.])];
        assert_eq!(matrix(&good).unwrap().w_axis, DVec4::new(5., 6., 7., 1.));
        assert_eq!(matrix(&good), matrix(&good[..3]));
        let mut doubled = good.clone().map(|row| row.iter().map(|v| 2.0 * v).collect::<Vec<f64>>());
        doubled[3][2] = 1e-8;
        assert_eq!(matrix(&doubled), matrix(&good));
        let flipped: Vec<_> = (0..4).map(|i| good.iter().map(|row| row[i]).collect()).collect();
        let cut = [vec![1.0; 3], vec![1.0; 3], vec![1.0; 3]];
        let skewed = [good[0].clone(), good[1].clone(), good[2].clone(), row([0., 0., 1e-4, 1.])];
        let five = [&good[..], &good[..1]].concat();
        for (rows, reason) in [
            (&good[..2], "4x4"),
            (&cut[..], "4x4"),
            (&five[..], "4x4"),
            (&skewed[..], "the last row"),
            (&flipped[..], "transposed"),
        ] {
            assert!(matrix(rows).unwrap_err().contains(reason), "{rows:?}");
        }
    }
}
