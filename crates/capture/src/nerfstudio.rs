//! nerfstudio and Instant-NGP: one `transforms.json`, shared or per-frame intrinsics, masks, a point cloud.

use crate::formats::ply_points::{self, Point};
use crate::masks::MaskFile;
use crate::photos::{PhotoEntry, Split, check_missing, locate};
use crate::truth::TruthFiles;
use crate::{CaptureError, CaptureFiles, transforms};

/// The file that marks this layout.
pub(super) const MARKER: &str = "transforms.json";

/// The photographs and the points of `ply_file_path`. The world is already +Z up.
///
/// # Errors
/// Names the field of `transforms.json`, the mask or the point cloud at fault.
pub(super) fn read(
    source: &CaptureFiles,
    warnings: &mut Vec<String>,
) -> Result<(Vec<PhotoEntry>, Vec<Point>), CaptureError> {
    let set = transforms::read(source, MARKER)?;
    let (mut photos, mut missing) = (Vec::new(), Vec::new());
    for frame in set.frames {
        let Some(image) = locate(source, &frame.path) else {
            missing.push(frame.path);
            continue;
        };
        photos.push(PhotoEntry {
            mask: frame.mask.map(|path| MaskFile { path, hides: false }),
            image,
            pose: frame.pose,
            lens: frame.lens,
            light_rotation_deg: frame.light_rotation_deg,
            stated_in: MARKER.to_owned(),
            split: if set.held_out.contains(&frame.path) { Split::Test } else { Split::Train },
            field: frame.field,
            truth: TruthFiles::default(),
        });
    }
    check_missing(MARKER, photos.len(), missing, warnings)?;
    let points = set.points.map_or(Ok(Vec::new()), |file| read_cloud(source, &file, warnings))?;
    Ok((photos, points))
}

/// The point cloud. A named file that is missing is a warning, since training does not need points.
fn read_cloud(
    source: &CaptureFiles,
    file: &str,
    warnings: &mut Vec<String>,
) -> Result<Vec<Point>, CaptureError> {
    if !source.contains(file) {
        warnings.push(format!("{MARKER} names the point cloud {file}, which is missing"));
        return Ok(Vec::new());
    }
    let points = ply_points::read_points(&source.read(file)?, source.limits().max_points);
    points.map_err(|e| CaptureError::at_field(file, e.field, e.reason))
}
