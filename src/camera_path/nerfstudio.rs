//! The camera path format of nerfstudio, as exported by its viewer.

use glam::{DMat4, DVec4};
use serde::Deserialize;
use serde_json::Value;

use crate::camera_path::fields::{fields, refused};
use relume_api::NerfstudioWorld;
use relume_api::problem::FieldError;
use relume_scene::Camera;
use relume_train::render::FrameView;

/// Image size of files without a size, pixels.
const SIZE: (u32, u32) = (1920, 1080);
/// Least field of view, degrees. A smaller number is an angle in radians.
const LEAST_FOV_DEG: f64 = 2.0;

/// The fields that determine the images. As in nerfstudio, `aspect` is not used: the size determines the aspect ratio.
#[derive(Debug, Deserialize)]
struct CameraPath {
    camera_type: Option<String>,
    /// Pixels. The viewer writes whole numbers as floating-point numbers.
    render_width: Option<f64>,
    render_height: Option<f64>,
    camera_path: Vec<PathEntry>,
}

#[derive(Debug, Deserialize)]
struct PathEntry {
    /// Row-major, OpenGL axes: 16 numbers, or rows of 4. The last row may be missing.
    camera_to_world: Value,
    /// Vertical field of view, degrees.
    fov: f64,
}

/// The views of a file with `camera_path`. Without `world` its poses are interpreted in the capture's world.
///
/// # Errors
/// The error names the field.
pub(super) fn views(json: &Value, world: Option<&NerfstudioWorld>) -> Result<Vec<FrameView>, FieldError> {
    let file: CameraPath = fields(json)?;
    if let Some(kind) = file.camera_type.as_deref().filter(|kind| !kind.eq_ignore_ascii_case("perspective")) {
        let detail = format!("{kind} is not supported; must be perspective");
        return Err(refused("/camera_type".to_owned(), &detail));
    }
    let size = size(&file)?;
    let view = |(i, entry): (usize, &PathEntry)| {
        entry
            .view(size, world)
            .map_err(|(field, reason)| refused(format!("/camera_path/{i}/{field}"), &reason))
    };
    file.camera_path.iter().enumerate().map(view).collect()
}

/// Width and height of the images, pixels.
fn size(file: &CameraPath) -> Result<(u32, u32), FieldError> {
    let side = |field: &str, value: f64| match value {
        value if value.fract() == 0.0 && (1.0..=f64::from(u32::MAX)).contains(&value) => Ok(value as u32),
        value => {
            let detail = format!("must be a whole number of pixels, at least 1, got {value}");
            Err(refused(format!("/{field}"), &detail))
        }
    };
    match (file.render_width, file.render_height) {
        (None, None) => Ok(SIZE),
        (Some(width), Some(height)) => Ok((side("render_width", width)?, side("render_height", height)?)),
        (Some(_), None) => Err(refused("/render_height".to_owned(), "is required with render_width")),
        (None, Some(_)) => Err(refused("/render_width".to_owned(), "is required with render_height")),
    }
}

impl PathEntry {
    /// The view of an image of `size`: width and height, pixels.
    ///
    /// # Errors
    /// The field, and why it is invalid.
    fn view(
        &self,
        size: (u32, u32),
        world: Option<&NerfstudioWorld>,
    ) -> Result<FrameView, (&'static str, String)> {
        let bad_pose = |reason| ("camera_to_world", reason);
        let pose = matrix(&self.camera_to_world).ok_or_else(|| {
            bad_pose("must be a matrix of 4x4 numbers: 16 in one list, row by row, or 4 rows of 4".to_owned())
        })?;
        // Before the world is applied, because that assumes a pose.
        Camera::check_last_row(&pose).map_err(|error| bad_pose(error.reason))?;
        let focal = 0.5 * f64::from(size.1) / (0.5 * field_of_view(self.fov)?.to_radians()).tan();
        let pose = world.map_or(pose, |world| world.to_capture_world(pose));
        let centre = (0.5 * f64::from(size.0), 0.5 * f64::from(size.1));
        let camera = Camera::from_opengl(&pose, size, (focal, focal), centre);
        let camera = camera.map_err(|error| bad_pose(error.reason))?;
        Ok(FrameView::new(camera, 0.0))
    }
}

/// A valid vertical field of view, degrees.
fn field_of_view(degrees: f64) -> Result<f64, (&'static str, String)> {
    if (LEAST_FOV_DEG..180.0).contains(&degrees) {
        return Ok(degrees);
    }
    let hint = match degrees > 0.0 && degrees < LEAST_FOV_DEG {
        true => format!("; {degrees} looks like radians, which are {:.1} degrees", degrees.to_degrees()),
        false => String::new(),
    };
    Err(("fov", format!("must be at least {LEAST_FOV_DEG} and less than 180 degrees, got {degrees}{hint}")))
}

/// A row-major matrix: 16 numbers or rows of 4, with or without the last row. `None` for anything else.
fn matrix(json: &Value) -> Option<DMat4> {
    let entries = json.as_array()?;
    let rows: Vec<&[Value]> = match entries.first()? {
        Value::Array(_) => {
            entries.iter().map(|row| row.as_array().map(Vec::as_slice)).collect::<Option<_>>()?
        }
        _ => entries.chunks(4).collect(),
    };
    let row = |values: &[Value]| -> Option<DVec4> {
        let [x, y, z, w] = values else { return None };
        Some(DVec4::new(x.as_f64()?, y.as_f64()?, z.as_f64()?, w.as_f64()?))
    };
    let rows = rows.into_iter().map(row).collect::<Option<Vec<_>>>()?;
    match rows[..] {
        [x, y, z] => Some(DMat4::from_cols(x, y, z, DVec4::W).transpose()),
        [x, y, z, last] => Some(DMat4::from_cols(x, y, z, last).transpose()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec3};
    use serde_json::json;

    fn camera() -> Camera {
        Camera::look_at(DVec3::new(3.0, 1.0, 2.0), DVec3::ZERO, DVec3::Z, 0.7, (64, 48)).unwrap()
    }

    /// A path of one camera with this matrix and field of view, at the size of [`camera`].
    fn path(matrix: Value, fov: f64) -> Value {
        let entry = json!({ "camera_to_world": matrix, "fov": fov, "aspect": 1.5 });
        json!({ "render_width": 64, "render_height": 48, "camera_path": [entry] })
    }

    fn refusal(path: &Value) -> (String, String) {
        let error = views(path, None).unwrap_err();
        (error.pointer, error.detail)
    }

    #[test]
    fn every_form_in_which_nerfstudio_writes_a_path_is_read() {
        let wanted = camera();
        let rows = wanted.to_opengl().transpose();
        let (nested, flat) = (rows.to_cols_array_2d(), rows.to_cols_array());
        let fov = 0.7f64.to_degrees();
        let mut floats = path(json!(flat), fov);
        floats["render_width"] = json!(64.0);
        floats["render_height"] = json!(48.0);
        floats["camera_type"] = json!("PERSPECTIVE");
        let forms = [
            path(json!(flat), fov),
            path(json!(nested), fov),
            path(json!(nested[..3]), fov),
            path(json!(flat[..12]), fov),
            floats,
        ];
        let off = |path: &Value| {
            let [view] = views(path, None).unwrap()[..] else { panic!("{path}") };
            assert_eq!((view.camera.width, view.camera.height), (64, 48), "{path}");
            (view.camera.centre() - wanted.centre()).length()
                + (view.camera.forward() - wanted.forward()).length()
                + (view.camera.fy / wanted.fy - 1.0).abs()
        };
        for path in forms {
            assert!(off(&path) < 1e-9, "{path}: {}", off(&path));
        }
        let inverse = wanted.to_opengl().inverse().transpose().to_cols_array();
        assert!(off(&path(json!(inverse), fov)) > 0.5, "the control: world to camera");
    }

    #[test]
    fn a_transposed_path_and_an_angle_in_radians_are_refused() {
        // The 16 numbers of three.js are the columns.
        let columns = camera().to_opengl().to_cols_array();
        let rows = camera().to_opengl().transpose().to_cols_array();
        let (pointer, detail) = refusal(&path(json!(columns), 40.0));
        assert_eq!(pointer, "/camera_path/0/camera_to_world");
        assert!(detail.contains("the last row must be 0 0 0 1"), "{detail}");
        assert!(detail.contains("looks transposed"), "{detail}");
        let (pointer, detail) = refusal(&path(json!(rows), 0.698));
        assert_eq!(pointer, "/camera_path/0/fov");
        assert!(detail.contains("radians, which are 40.0 degrees"), "{detail}");
        for fov in [0.0, -40.0, 180.0, 1.99] {
            assert_eq!(refusal(&path(json!(rows), fov)).0, "/camera_path/0/fov", "{fov}");
        }
        assert!(views(&path(json!(rows), 2.0), None).is_ok(), "the control");
    }

    #[test]
    fn sizes_and_matrices_of_another_form_are_refused_by_name() {
        let rows = camera().to_opengl().transpose().to_cols_array();
        let sized = |width: Value, height: Value| {
            let mut path = path(json!(rows), 40.0);
            path["render_width"] = width;
            path["render_height"] = height;
            path
        };
        for (width, height, pointer) in [
            (json!(64.5), json!(48), "/render_width"),
            (json!(0), json!(48), "/render_width"),
            (json!(64), json!(-48.0), "/render_height"),
            (json!(64), json!(1e12), "/render_height"),
            (json!(64), Value::Null, "/render_height"),
            (Value::Null, json!(48), "/render_width"),
            (json!("64"), json!(48), "/render_width"),
        ] {
            assert_eq!(refusal(&sized(width.clone(), height.clone())).0, pointer, "{width} {height}");
        }
        assert!(views(&sized(json!(64), json!(48)), None).is_ok(), "the control");
        let nested = camera().to_opengl().transpose().to_cols_array_2d();
        for matrix in [
            json!(null),
            json!([]),
            json!([[]]),
            json!(rows[..15]),
            json!(rows[..8]),
            json!(nested[..2]),
            json!([nested[0], nested[1], nested[2], [0, 0, 1]]),
            json!([nested[0], nested[1], nested[2], "0 0 0 1"]),
            json!("1 0 0 0"),
        ] {
            let (pointer, detail) = refusal(&path(matrix.clone(), 40.0));
            assert_eq!(pointer, "/camera_path/0/camera_to_world", "{matrix}");
            assert!(detail.contains("4 rows of 4"), "{matrix}: {detail}");
        }
    }

    #[test]
    fn nerfstudio_path_is_transformed_back_to_capture_coordinates() {
        let camera = camera();
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
