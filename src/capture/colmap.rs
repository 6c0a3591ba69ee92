//! COLMAP sparse models: posed images with their cameras, and the sparse points.

use glam::{DMat3, DMat4, DQuat, DVec3};

use crate::capture::colmap_files::{self, Model, PosedImage};
use crate::capture::photos::{Photo, check_missing};
use crate::capture::truth::TruthFiles;
use crate::capture::{CaptureError, Source};
use crate::formats::ply_points::Point;

/// Where a sparse model may lie, best first.
const FOLDERS: [&str; 5] = ["sparse/0/", "sparse/", "colmap/sparse/0/", "0/", ""];
/// Where its photographs may lie.
const IMAGE_FOLDERS: [&str; 6] = ["images/", "", "input/", "images_2/", "images_4/", "images_8/"];

/// The folder of a sparse model and the ending of its files, if there is one.
pub(super) fn find(source: &Source) -> Option<(String, &'static str)> {
    let endings = [".bin", ".txt"];
    let candidates = FOLDERS.iter().flat_map(|f| endings.iter().map(move |e| (f, *e)));
    let whole = |f: &&str, e: &str| {
        ["cameras", "images"].iter().all(|name| source.contains(&format!("{f}{name}{e}")))
    };
    candidates.filter(|(f, e)| whole(f, e)).map(|(f, e)| ((*f).to_owned(), e)).next()
}

/// The photographs and points, in a world turned so that the cameras' mean up is +Z.
///
/// # Errors
/// Names the model file and the field at fault, or counts the images when too few are there.
pub(super) fn read(
    source: &Source,
    (folder, ending): (&str, &str),
    warnings: &mut Vec<String>,
) -> Result<(Vec<Photo>, Vec<Point>), CaptureError> {
    let model = colmap_files::read(source, folder, ending)?;
    let turn = upright(&model.images, warnings);
    let images_file = format!("{folder}images{ending}");
    let (mut photos, mut missing) = (Vec::new(), Vec::new());
    for image in &model.images {
        match locate(source, &image.name) {
            Some(path) => photos.push(photo(source, &model, image, path, turn, &images_file)?),
            None => missing.push(image.name.clone()),
        }
    }
    check_missing(&images_file, photos.len(), missing, warnings)?;
    let points = model.points.into_iter().map(|(p, colour)| (turn * p, colour)).collect();
    Ok((photos, points))
}

fn locate(source: &Source, name: &str) -> Option<String> {
    IMAGE_FOLDERS.iter().map(|folder| format!("{folder}{name}")).find(|path| source.contains(path))
}

fn photo(
    source: &Source,
    model: &Model,
    image: &PosedImage,
    path: String,
    turn: DQuat,
    stated_in: &str,
) -> Result<Photo, CaptureError> {
    let field = format!("images[{}]", image.name);
    let lens = model.lenses.get(&image.camera).ok_or_else(|| CaptureError::Field {
        file: stated_in.to_owned(),
        field: format!("{field}.camera_id"),
        reason: format!("there is no camera {}", image.camera),
    })?;
    let stem = image.name.rsplit_once('.').map_or(image.name.as_str(), |(stem, _)| stem);
    let masks = [format!("masks/{}.png", image.name), format!("masks/{stem}.png")];
    Ok(Photo {
        image: path,
        mask: masks.into_iter().find(|m| source.contains(m)),
        pose: pose(image, turn),
        lens: *lens,
        stated_in: stated_in.to_owned(),
        field,
        held_out: false,
        truth: TruthFiles::default(),
    })
}

/// Camera-to-world with OpenGL axes, in the turned world.
fn pose(image: &PosedImage, turn: DQuat) -> DMat4 {
    let to_world = DMat3::from_quat(turn * image.rotation.inverse());
    let centre = -(to_world * image.translation);
    let axes = DMat3::from_cols(to_world.x_axis, -to_world.y_axis, -to_world.z_axis);
    let mut pose = DMat4::from_mat3(axes);
    pose.w_axis = centre.extend(1.0);
    pose
}

/// The rotation that takes the cameras' mean up direction to +Z.
fn upright(images: &[PosedImage], warnings: &mut Vec<String>) -> DQuat {
    let up = |image: &PosedImage| image.rotation.inverse() * -DVec3::Y;
    let mean = images.iter().map(up).sum::<DVec3>() / images.len().max(1) as f64;
    if mean.length() < 0.2 {
        warnings
            .push("the cameras agree on no up direction; the world is left as COLMAP turned it".to_owned());
        return DQuat::IDENTITY;
    }
    DQuat::from_rotation_arc(mean.normalize(), DVec3::Z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Camera;

    #[test]
    fn a_point_ahead_lands_where_colmap_projects_it_and_up_becomes_z() {
        let rotation = DQuat::from_euler(glam::EulerRot::XYZ, 1.4, 0.2, -0.3);
        let image =
            PosedImage { name: "a.jpg".into(), camera: 1, rotation, translation: DVec3::new(0.3, -0.2, 2.0) };
        let turn = upright(std::slice::from_ref(&image), &mut Vec::new());
        let camera = Camera::from_opengl(&pose(&image, turn), (100, 80), (90.0, 95.0), (50.0, 40.0)).unwrap();
        let world = DVec3::new(0.2, 0.1, 0.4);
        let expected = rotation * world + image.translation;
        let got = camera.rotation * (turn * world) + camera.translation;
        assert!((got - expected).length() < 1e-12, "{got} {expected}");
        assert!((-camera.rotation.row(1) - DVec3::Z).length() < 1e-9, "this camera's up is the world's");
        assert!((got - (rotation * (turn * world) + image.translation)).length() > 0.1, "the turn matters");
    }

    #[test]
    fn cameras_without_a_common_up_leave_the_world_alone() {
        let image = |rotation| PosedImage { name: "a".into(), camera: 1, rotation, translation: DVec3::ZERO };
        let mut warnings = Vec::new();
        let turn = upright(&[image(DQuat::IDENTITY), image(DQuat::from_rotation_z(3.1))], &mut warnings);
        assert_eq!((turn, warnings.len()), (DQuat::IDENTITY, 1));
    }
}
