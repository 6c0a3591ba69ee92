//! Cameras from a file: Relume's own JSON, nerfstudio's camera path and transforms.json, COLMAP models.

use std::path::Path;

use serde::Deserialize;
use serde_json::Value;

use super::args::CameraArgs;
use super::nerfstudio_path;
use super::views::View;
use crate::api::cameras::CameraSpec;
use crate::capture::{ImportLimits, PhotoCamera, cameras_of_colmap, cameras_of_transforms};
use crate::cli::input;
use crate::scene::Camera;

/// Most frames of a file.
const MOST_FRAMES: usize = 100_000;

/// Relume's own file of cameras. An answer of `GET /v1/captures/{id}/cameras` is one.
#[derive(Debug, Deserialize)]
struct CameraFile {
    /// Size of pictures whose camera states none, pixels.
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

/// The views of the file or folder at `path`.
///
/// # Errors
/// Names the file and the field at fault.
pub(super) fn read(path: &Path, args: &CameraArgs) -> Result<Vec<View>, String> {
    let named = |error: String| format!("{}: {error}", path.display());
    if path.is_dir() {
        let cameras = cameras_of_colmap(path, &ImportLimits::default()).map_err(|e| named(e.to_string()))?;
        return sized(cameras.iter().map(of_photo).collect(), args).map_err(named);
    }
    let bytes = input::read(path)?;
    let world = args.path_world.as_deref().map(nerfstudio_path::read_world).transpose()?;
    sized(parse(&bytes, args, world.as_ref()).map_err(named)?, args).map_err(named)
}

/// The views of a JSON file, whichever of its kinds it is.
fn parse(
    bytes: &[u8],
    args: &CameraArgs,
    world: Option<&nerfstudio_path::World>,
) -> Result<Vec<View>, String> {
    let json: Value = serde_json::from_slice(bytes).map_err(|error| format!("is not valid JSON: {error}"))?;
    let size = args.resolution.unwrap_or((args.size, args.size));
    match ["cameras", "camera_path", "frames"].into_iter().find(|key| json.get(key).is_some()) {
        Some("camera_path") => nerfstudio_path::views(json, world),
        _ if world.is_some() => Err("--path-world is of files with a camera_path alone".to_owned()),
        Some("cameras") => own(json, size),
        Some(_) => {
            let cameras = cameras_of_transforms("frames", bytes, Some(size)).map_err(|e| e.to_string())?;
            Ok(cameras.iter().map(of_photo).collect())
        }
        None => {
            Err("has none of `cameras`, `camera_path` (nerfstudio) and `frames` (transforms.json)".into())
        }
    }
}

fn own(json: Value, otherwise: (u32, u32)) -> Result<Vec<View>, String> {
    let file: CameraFile = input::from_json(json)?;
    let view = |(i, entry): (usize, &CameraEntry)| {
        let size = (entry.width.or(file.width), entry.height.or(file.height));
        let size = size.0.zip(size.1).unwrap_or(otherwise);
        let camera = entry.camera.camera(size);
        let camera = camera
            .map_err(|e| format!("cameras[{i}].camera{}: {}", e.pointer.replace('/', "."), e.detail))?;
        if !entry.light_rotation_deg.is_finite() {
            return Err(format!("cameras[{i}].light_rotation_deg: must be finite"));
        }
        Ok(View { camera, light_turn_deg: entry.light_rotation_deg })
    };
    file.cameras.iter().enumerate().map(view).collect()
}

fn of_photo(photo: &PhotoCamera) -> View {
    View { camera: photo.camera, light_turn_deg: photo.light_rotation_deg }
}

/// The views at the resolution that was asked for.
fn sized(views: Vec<View>, args: &CameraArgs) -> Result<Vec<View>, String> {
    if !(1..=MOST_FRAMES).contains(&views.len()) {
        return Err(format!("has {} cameras; 1 to {MOST_FRAMES} are rendered", views.len()));
    }
    let Some((width, height)) = args.resolution else { return Ok(views) };
    let resized = |(i, view): (usize, View)| {
        let Camera { width: w, height: h, .. } = view.camera;
        let aspects = [(w, h), (width, height)].map(|(w, h)| f64::from(w) / f64::from(h));
        if (aspects[0] / aspects[1] - 1.0).abs() > 0.01 {
            return Err(format!("camera {} is of {w}x{h}, which {width}x{height} would stretch", i + 1));
        }
        Ok(View { camera: view.camera.resized(width, height), ..view })
    };
    views.into_iter().enumerate().map(resized).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use serde_json::json;

    fn args(resolution: Option<(u32, u32)>) -> CameraArgs {
        CameraArgs {
            azimuth: None,
            elevation: None,
            size: 64,
            resolution,
            path: None,
            path_world: None,
            turntable: None,
            camera_turn: 360.0,
            env_turn: 0.0,
        }
    }

    fn views(json: &Value, resolution: Option<(u32, u32)>) -> Result<Vec<View>, String> {
        let args = args(resolution);
        sized(parse(json.to_string().as_bytes(), &args, None)?, &args)
    }

    fn camera() -> Camera {
        Camera::look_at(DVec3::new(3.0, 1.0, 1.0), DVec3::ZERO, DVec3::Z, 0.7, (64, 48)).unwrap()
    }

    fn rows(matrix: glam::DMat4) -> [[f64; 4]; 4] {
        matrix.transpose().to_cols_array_2d()
    }

    #[test]
    fn one_camera_is_the_same_view_however_it_is_written() {
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
            let [view] = views(&file, None).unwrap()[..] else { panic!("{file}") };
            assert_eq!((view.camera.width, view.camera.height, view.light_turn_deg), (64, 48, 0.0));
            let off = (view.camera.centre() - wanted.centre()).length()
                + (view.camera.forward() - wanted.forward()).length()
                + (view.camera.fx / wanted.fx - 1.0).abs()
                + (view.camera.fy / wanted.fy - 1.0).abs();
            assert!(off < 1e-9, "{file}: {off}");
        }
        let mistaken = own(json!({ "camera_to_world": rows(wanted.to_opencv()), "fov_y_deg": fov }));
        let forward = views(&mistaken, None).unwrap()[0].camera.forward();
        assert!((forward - wanted.forward()).length() > 1.0, "the control: axes taken for others");
    }

    #[test]
    fn a_resolution_scales_cameras_and_stretches_none() {
        let file = json!({ "width": 64, "height": 48, "cameras": [{ "light_rotation_deg": 30,
            "camera": { "look_at": { "eye": [3, 0, 0], "target": [0, 0, 0], "fov_y_deg": 40 } } }] });
        let small = views(&file, None).unwrap()[0];
        let large = views(&file, Some((128, 96))).unwrap()[0];
        assert_eq!((large.camera.width, large.camera.height, large.light_turn_deg), (128, 96, 30.0));
        assert!((large.camera.fy - 2.0 * small.camera.fy).abs() < 1e-9);
        assert!(views(&file, Some((128, 128))).unwrap_err().contains("stretch"));
    }

    #[test]
    fn what_is_wrong_is_named() {
        let look = json!({ "look_at": { "eye": [3, 0, 0], "target": [3, 0, 0], "fov_y_deg": 40 } });
        for (file, word) in [
            (json!({}), "camera_path"),
            (json!({ "cameras": [] }), "has 0 cameras"),
            (json!({ "cameras": [{ "camera": {} }] }), "cameras[0].camera: must have one of"),
            (json!({ "cameras": [{ "camera": look }] }), "cameras[0].camera.look_at.target"),
            (json!({ "cameras": [{ "camera": { "fov": 3 } }] }), "cameras[0].camera.fov"),
            (json!({ "camera_path": [{ "camera_to_world": [1, 2], "fov": 50 }] }), "camera_path[0]"),
            (json!({ "camera_type": "equirectangular", "camera_path": [] }), "equirectangular"),
            (json!({ "frames": [{ "file_path": "a" }] }), "frames[0].transform_matrix"),
        ] {
            let error = views(&file, None).unwrap_err();
            assert!(error.contains(word), "{file}: {error}");
        }
    }
}
