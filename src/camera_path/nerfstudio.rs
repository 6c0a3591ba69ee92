//! The camera path format of nerfstudio, as exported by its viewer.

use glam::DMat4;
use serde::Deserialize;
use serde_json::Value;

use crate::camera_path::fields::fields;
use relume_api::NerfstudioWorld;
use relume_api::problem::FieldError;
use relume_scene::Camera;
use relume_train::render::FrameView;

/// Image size of files without a size, pixels, as in nerfstudio.
const SIZE: (u32, u32) = (1920, 1080);

#[derive(Debug, Deserialize)]
struct CameraPath {
    camera_type: Option<String>,
    render_width: Option<u32>,
    render_height: Option<u32>,
    camera_path: Vec<PathEntry>,
}

#[derive(Debug, Deserialize)]
struct PathEntry {
    /// Row-major, OpenGL axes.
    camera_to_world: Vec<f64>,
    /// Vertical field of view, degrees.
    fov: f64,
}

/// The views of a file with `camera_path`. Without `world` its poses are interpreted in the capture's world.
///
/// # Errors
/// The error names the field.
pub(super) fn views(json: &Value, world: Option<&NerfstudioWorld>) -> Result<Vec<FrameView>, FieldError> {
    let refused = |pointer: String, detail: &str| FieldError { pointer, detail: detail.to_owned() };
    let file: CameraPath = fields(json)?;
    if let Some(kind) = file.camera_type.as_deref().filter(|kind| *kind != "perspective") {
        let detail = format!("{kind} is not supported; must be perspective");
        return Err(refused("/camera_type".to_owned(), &detail));
    }
    let size = file.render_width.zip(file.render_height).unwrap_or(SIZE);
    let view = |(i, entry): (usize, &PathEntry)| {
        let bad = |field: &str, reason: &str| refused(format!("/camera_path/{i}/{field}"), reason);
        let matrix: [f64; 16] = entry
            .camera_to_world
            .as_slice()
            .try_into()
            .map_err(|_| bad("camera_to_world", "must be 16 numbers"))?;
        if !(entry.fov > 0.0 && entry.fov < 180.0) {
            return Err(bad("fov", "must be more than 0 and less than 180"));
        }
        let pose = DMat4::from_cols_array(&matrix).transpose();
        let pose = world.map_or(pose, |world| world.to_capture_world(pose));
        let focal = 0.5 * f64::from(size.1) / (0.5 * entry.fov.to_radians()).tan();
        let centre = (0.5 * f64::from(size.0), 0.5 * f64::from(size.1));
        let camera = Camera::from_opengl(&pose, size, (focal, focal), centre);
        let camera = camera.map_err(|error| bad("camera_to_world", &error.reason))?;
        Ok(FrameView { camera, light_rotation_deg: 0.0 })
    };
    file.camera_path.iter().enumerate().map(view).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec3, DVec4};
    use serde_json::json;

    #[test]
    fn nerfstudio_path_is_transformed_back_to_capture_coordinates() {
        let camera =
            Camera::look_at(DVec3::new(3.0, 1.0, 2.0), DVec3::ZERO, DVec3::Z, 0.7, (64, 48)).unwrap();
        let mut transform = DMat4::from_mat3(DMat3::from_rotation_z(0.4) * DMat3::from_rotation_x(-0.3));
        transform.w_axis = DVec4::new(0.5, -1.0, 2.0, 1.0);
        let mut moved = transform * camera.to_opengl();
        moved.w_axis = (moved.w_axis.truncate() * 0.25).extend(1.0);
        let path =
            json!({ "camera_path": [{ "camera_to_world": moved.transpose().to_cols_array(), "fov": 40 }] });
        let rows = transform.transpose().to_cols_array_2d();
        let world = NerfstudioWorld { transform: [rows[0], rows[1], rows[2]], scale: 0.25 };
        let off = |world: Option<&NerfstudioWorld>| {
            let seen = views(&path, world).unwrap()[0].camera;
            (seen.centre() - camera.centre()).length() + (seen.forward() - camera.forward()).length()
        };
        assert!(off(Some(&world)) < 1e-9, "{}", off(Some(&world)));
        assert!(off(None) > 0.5, "the control: poses in the world of nerfstudio");
    }
}
