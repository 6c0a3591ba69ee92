//! COLMAP sparse models: posed images with their cameras, and the sparse points.

mod binary;
mod camera_models;
mod find;
mod model;
#[cfg(test)]
mod tests;
mod text;

use glam::{DMat3, DMat4, DQuat};

use self::binary::ByteReader;
use self::find::ModelEncoding;
pub(super) use self::find::{ModelFiles, find};
use self::model::{PosedImage, SparseModel};
use self::text::TextFile;
use crate::formats::ply_points::Point;
use crate::photo_finder::PhotoFinder;
use crate::photos::{PhotoEntry, Split};
use crate::truth::TruthFiles;
use crate::upright::{StatedUp, upright};
use crate::{CaptureError, CaptureFiles, Up, WorldUp};

/// The photographs and points, in a world rotated so that up is +Z.
///
/// # Errors
/// Names the model file and the field at fault, or counts the images if too few are present.
pub(super) fn read(
    source: &CaptureFiles,
    files: &ModelFiles,
    up: Up,
    warnings: &mut Vec<String>,
) -> Result<(Vec<PhotoEntry>, Vec<Point>, WorldUp), CaptureError> {
    let model = read_model(source, files)?;
    let world = world_up(&model, up, warnings);
    let turn = world.rotation();
    let images_file = files.path("images");
    warnings.extend(files.unused.clone());
    let mut finder = PhotoFinder::new(source, files.photo_folders());
    let paths = finder.find_all(&model.images.iter().map(|image| image.name.as_str()).collect::<Vec<_>>());
    let mut photos = Vec::new();
    for (image, path) in model.images.iter().zip(paths) {
        if let Some(path) = path {
            photos.push(photo(&model, image, path, turn, &images_file)?);
        }
    }
    finder.finish(&images_file, photos.len(), warnings)?;
    let points = model.points.into_iter().map(|(p, colour)| (turn * p, colour)).collect();
    Ok((photos, points, world))
}

/// The photographs that a model names, present or not, in the world of [`read`].
///
/// # Errors
/// Names the model file and the field at fault.
pub(super) fn stated(
    source: &CaptureFiles,
    files: &ModelFiles,
    up: Up,
    warnings: &mut Vec<String>,
) -> Result<Vec<PhotoEntry>, CaptureError> {
    let model = read_model(source, files)?;
    let world = world_up(&model, up, warnings);
    let turn = world.rotation();
    let images_file = files.path("images");
    let of = |image: &PosedImage| photo(&model, image, image.name.clone(), turn, &images_file);
    model.images.iter().map(of).collect()
}

/// Reads `cameras`, `images` and, if it exists, `points3D`.
///
/// # Errors
/// Names the file, and the entry whose value is unusable.
fn read_model(source: &CaptureFiles, files: &ModelFiles) -> Result<SparseModel, CaptureError> {
    let [in_cameras, in_images, in_points] = &["cameras", "images", "points3D"].map(|name| files.path(name));
    let limits = source.limits();
    let (cameras, images) = (source.read(in_cameras)?, source.read(in_images)?);
    let points = source.contains(in_points).then(|| source.read(in_points)).transpose()?;
    match files.encoding {
        ModelEncoding::Binary => Ok(SparseModel {
            lenses: binary::cameras(ByteReader::new(in_cameras, &cameras))?,
            images: binary::images(ByteReader::new(in_images, &images), limits.max_images)?,
            points: points.map_or(Ok(Vec::new()), |bytes| {
                binary::points(ByteReader::new(in_points, &bytes), limits.max_points)
            })?,
        }),
        ModelEncoding::Text => Ok(SparseModel {
            lenses: text::cameras(&TextFile::new(in_cameras, &cameras)?)?,
            images: text::images(&TextFile::new(in_images, &images)?, limits.max_images)?,
            points: points.map_or(Ok(Vec::new()), |bytes| {
                text::points(&TextFile::new(in_points, &bytes)?, limits.max_points)
            })?,
        }),
    }
}

fn photo(
    model: &SparseModel,
    image: &PosedImage,
    path: String,
    turn: DQuat,
    stated_in: &str,
) -> Result<PhotoEntry, CaptureError> {
    let field = format!("images[{}]", image.name);
    let lens = model.lenses.get(&image.camera).ok_or_else(|| {
        let reason = format!("the model has no camera {}", image.camera);
        CaptureError::at_field(stated_in, format!("{field}.camera_id"), reason)
    })?;
    Ok(PhotoEntry {
        mask: None,
        image: path,
        pose: pose(image, turn),
        lens: *lens,
        light_rotation_deg: 0.0,
        light_group: None,
        stated_in: stated_in.to_owned(),
        field,
        split: Split::Train,
        truth: TruthFiles::default(),
    })
}

/// The up direction, from all images of the model, present or not.
fn world_up(model: &SparseModel, up: Up, warnings: &mut Vec<String>) -> WorldUp {
    let poses: Vec<_> = model.images.iter().map(|image| pose(image, DQuat::IDENTITY)).collect();
    upright(&poses, &model.points, up, StatedUp::No("COLMAP"), warnings)
}

/// Camera-to-world with OpenGL axes, in the rotated world.
fn pose(image: &PosedImage, turn: DQuat) -> DMat4 {
    let to_world = DMat3::from_quat(turn * image.rotation.inverse());
    let centre = -(to_world * image.translation);
    let axes = DMat3::from_cols(to_world.x_axis, -to_world.y_axis, -to_world.z_axis);
    let mut pose = DMat4::from_mat3(axes);
    pose.w_axis = centre.extend(1.0);
    pose
}
