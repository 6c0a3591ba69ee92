//! nerfstudio and Instant-NGP: one `transforms.json`, shared or per-frame intrinsics, masks, a point cloud.

use crate::formats::ply_points::{self, Point};
use crate::masks::MaskFile;
use crate::photo_finder::PhotoFinder;
use crate::photos::{PhotoEntry, Split};
use crate::truth::TruthFiles;
use crate::upright::{self, StatedUp, upright};
use crate::{CaptureError, CaptureFiles, Up, WorldUp, layout, pose_conventions, transforms};

/// The file that marks this layout.
pub(super) const MARKER: &str = "transforms.json";

/// The photographs of the JSON file `marker` and the points of its `ply_file_path`. The world is rotated if `up` says so
/// or its +Z is only the mean up direction of the cameras.
///
/// # Errors
/// Names the field of the file, the mask or the point cloud at fault.
pub(super) fn read(
    source: &CaptureFiles,
    marker: &str,
    up: Up,
    warnings: &mut Vec<String>,
) -> Result<(Vec<PhotoEntry>, Vec<Point>, WorldUp), CaptureError> {
    let set = transforms::read(source, marker)?;
    let mut finder = PhotoFinder::new(source, vec![layout::folder_of(marker), String::new()]);
    let stated = StatedUp::plus_z(&set.frames.iter().map(|frame| frame.pose).collect::<Vec<_>>());
    let mut photos = Vec::new();
    let images = finder.find_all(&set.frames.iter().map(|frame| frame.path.as_str()).collect::<Vec<_>>());
    for (frame, image) in set.frames.into_iter().zip(images) {
        let Some(image) = image else { continue };
        photos.push(PhotoEntry {
            mask: frame.mask.map(|path| MaskFile { path, hides: false }),
            image,
            pose: frame.pose,
            lens: frame.lens,
            light_rotation_deg: frame.light_rotation_deg,
            light_group: frame.light_group,
            stated_in: marker.to_owned(),
            split: if set.held_out.contains(&frame.path) { Split::Test } else { Split::Train },
            field: frame.field,
            truth: TruthFiles::default(),
        });
    }
    finder.finish(marker, photos.len(), warnings)?;
    let mut points = set.points.map_or(Ok(Vec::new()), |file| read_cloud(source, marker, &file, warnings))?;
    pose_conventions::convert(&mut photos, &points, warnings);
    let poses: Vec<_> = photos.iter().map(|photo| photo.pose).collect();
    let world = upright(&poses, &points, up, stated, warnings);
    upright::rotate(world.rotation(), &mut photos, &mut points);
    Ok((photos, points, world))
}

/// The point cloud: the named file, or the only file of its name. A missing one is a warning, since training does not need
/// points.
fn read_cloud(
    source: &CaptureFiles,
    marker: &str,
    stated: &str,
    warnings: &mut Vec<String>,
) -> Result<Vec<Point>, CaptureError> {
    let name = |path: &str| path.rsplit(['/', '\\']).next().unwrap_or_default().to_owned();
    let same: Vec<&str> = source.paths().filter(|path| name(path) == name(stated)).collect();
    let file = match (
        transforms::relative(&format!("{}{stated}", layout::folder_of(marker)))
            .filter(|path| source.contains(path)),
        &same[..],
    ) {
        (Some(path), _) => path,
        (None, [path]) => (*path).to_owned(),
        _ => {
            warnings.push(format!("{marker} names the point cloud {stated}, which is missing"));
            return Ok(Vec::new());
        }
    };
    let points = ply_points::read_points(&source.read(&file)?, source.limits().max_points);
    points.map_err(|e| CaptureError::at_field(&file, e.field, e.reason))
}
