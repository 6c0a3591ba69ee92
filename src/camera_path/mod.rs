//! Camera paths in JSON: Relume's own format, nerfstudio's camera path, and the frames of a transforms.json.

mod fields;
mod nerfstudio;

use serde::Deserialize;
use serde_json::Value;

use crate::camera_path::fields::{fields, pointer, refused};
use relume_api::NerfstudioWorld;
use relume_api::cameras::CameraSpec;
use relume_api::problem::FieldError;
use relume_capture::{CaptureError, PhotoCamera, Up, cameras_of_transforms};
use relume_train::render::FrameView;

/// Relume's own camera file. The answer of `GET /v1/captures/{id}/cameras` has this format.
#[derive(Debug, Deserialize)]
struct CameraFile {
    /// Image size of cameras without a size, pixels.
    width: Option<u32>,
    height: Option<u32>,
    cameras: Vec<CameraEntry>,
}

#[derive(Debug, Deserialize)]
struct CameraEntry {
    width: Option<u32>,
    height: Option<u32>,
    camera: CameraSpec,
    #[serde(default)]
    light_rotation_deg: f64,
}

/// The views of a camera path in any supported format. Cameras without a size get `size`, width and height in pixels. `world`
/// transforms a `camera_path` of nerfstudio back to the world of the capture. `up` is that of the model, for the frames of a
/// `transforms.json`, which have the axes of the capture's files.
///
/// # Errors
/// The pointer leads from the path to the invalid field. It is empty if the format is not supported.
pub fn path_views(
    json: &Value,
    size: (u32, u32),
    world: Option<&NerfstudioWorld>,
    up: Up,
) -> Result<Vec<FrameView>, FieldError> {
    match ["cameras", "camera_path", "frames"].into_iter().find(|key| json.get(key).is_some()) {
        Some("camera_path") => nerfstudio::views(json, world),
        _ if world.is_some() => {
            Err(refused(String::new(), "must be a `camera_path` of nerfstudio if path_world is given"))
        }
        Some("cameras") => own(json, size),
        Some(_) => of_transforms(json, size, up),
        None => Err(refused(
            String::new(),
            "must have `cameras`, `camera_path` (nerfstudio) or `frames` (transforms.json)",
        )),
    }
}

/// The view of a photograph.
pub fn photo_view(photo: &PhotoCamera) -> FrameView {
    FrameView::new(photo.camera, photo.light_rotation_deg)
}

fn own(json: &Value, otherwise: (u32, u32)) -> Result<Vec<FrameView>, FieldError> {
    let file: CameraFile = fields(json)?;
    let view = |(i, entry): (usize, &CameraEntry)| {
        let size = (entry.width.or(file.width), entry.height.or(file.height));
        let size = size.0.zip(size.1).unwrap_or(otherwise);
        let camera = entry.camera.camera(size).map_err(|error| FieldError {
            pointer: format!("/cameras/{i}/camera{}", error.pointer),
            ..error
        })?;
        if !entry.light_rotation_deg.is_finite() {
            return Err(refused(format!("/cameras/{i}/light_rotation_deg"), "must be finite"));
        }
        Ok(FrameView::new(camera, entry.light_rotation_deg))
    };
    file.cameras.iter().enumerate().map(view).collect()
}

fn of_transforms(json: &Value, size: (u32, u32), up: Up) -> Result<Vec<FrameView>, FieldError> {
    let bytes = json.to_string().into_bytes();
    let cameras = cameras_of_transforms("frames", &bytes, Some(size), up).map_err(|error| match &error {
        CaptureError::Field { field, reason, .. } => refused(pointer(field), reason),
        error => refused(String::new(), &error.to_string()),
    })?;
    Ok(cameras.iter().map(photo_view).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use relume_scene::Camera;
    use serde_json::json;

    fn views(json: &Value) -> Result<Vec<FrameView>, FieldError> {
        path_views(json, (64, 64), None, Up::AUTO)
    }

    fn camera() -> Camera {
        Camera::look_at(DVec3::new(3.0, 1.0, 1.0), DVec3::ZERO, DVec3::Z, 0.7, (64, 48)).unwrap()
    }

    fn rows(matrix: glam::DMat4) -> [[f64; 4]; 4] {
        matrix.transpose().to_cols_array_2d()
    }

    #[test]
    fn all_camera_formats_give_the_same_view() {
        let wanted = camera();
        let (fov, opengl) = (0.7f64.to_degrees(), rows(wanted.to_opengl()));
        let (qvec, tvec) = wanted.to_colmap();
        let flat: Vec<f64> = opengl.into_iter().flatten().collect();
        let own = |camera: Value| json!({ "width": 64, "height": 48, "cameras": [{ "camera": camera }] });
        let files = [
            own(json!({ "look_at": { "eye": [3, 1, 1], "target": [0, 0, 0], "fov_y_deg": fov } })),
            own(json!({ "camera_to_world": opengl, "fov_y_deg": fov })),
            own(json!({ "camera_to_world": rows(wanted.to_opencv()), "axes": "opencv", "fov_y_deg": fov })),
            own(json!({ "colmap": { "qvec": qvec, "tvec": tvec }, "fov_y_deg": fov })),
            json!({ "render_width": 64, "render_height": 48,
                    "camera_path": [{ "camera_to_world": flat, "fov": fov, "aspect": 64.0 / 48.0 }] }),
            json!({ "w": 64, "h": 48, "fl_x": wanted.fx,
                    "frames": [{ "file_path": "nowhere.png", "transform_matrix": opengl }] }),
        ];
        for file in files {
            let [view] = views(&file).unwrap()[..] else { panic!("{file}") };
            assert_eq!((view.camera.width, view.camera.height, view.light_rotation_deg), (64, 48, 0.0));
            let off = (view.camera.centre() - wanted.centre()).length()
                + (view.camera.forward() - wanted.forward()).length()
                + (view.camera.fx / wanted.fx - 1.0).abs()
                + (view.camera.fy / wanted.fy - 1.0).abs();
            assert!(off < 1e-9, "{file}: {off}");
        }
        let mistaken = own(json!({ "camera_to_world": rows(wanted.to_opencv()), "fov_y_deg": fov }));
        let forward = views(&mistaken).unwrap()[0].camera.forward();
        assert!((forward - wanted.forward()).length() > 1.0, "the control: with the wrong axis convention");
    }

    #[test]
    fn invalid_camera_paths_are_refused_with_a_pointer() {
        let look = json!({ "look_at": { "eye": [3, 0, 0], "target": [3, 0, 0], "fov_y_deg": 40 } });
        let transposed = rows(camera().to_opengl().transpose());
        for (file, wanted) in [
            (json!({}), ""),
            (json!({ "cameras": [{ "camera": {} }] }), "/cameras/0/camera"),
            (json!({ "cameras": [{ "camera": look }] }), "/cameras/0/camera/look_at/target"),
            (json!({ "cameras": [{ "camera": { "fov": 3 } }] }), "/cameras/0/camera/fov"),
            (
                json!({ "cameras": [{ "camera": { "camera_to_world": transposed, "fov_y_deg": 40 } }] }),
                "/cameras/0/camera/camera_to_world",
            ),
            (
                json!({ "camera_path": [{ "camera_to_world": [1, 2], "fov": 50 }] }),
                "/camera_path/0/camera_to_world",
            ),
            (json!({ "camera_type": "equirectangular", "camera_path": [] }), "/camera_type"),
            (json!({ "frames": [{ "file_path": "a" }] }), "/frames/0/transform_matrix"),
        ] {
            assert_eq!(views(&file).unwrap_err().pointer, wanted, "{file}");
        }
        let world = NerfstudioWorld::deserialize(
            json!({ "transform": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], "scale": 0 }),
        );
        assert!(world.unwrap().check().is_err());
    }
}
