//! Cameras from a file: Relume's own JSON, nerfstudio's camera path and transforms.json, COLMAP models.

use std::path::Path;

use serde_json::Value;

use super::args::CameraArgs;
use crate::camera_path::{path_views, photo_view};
use crate::cli::input;
use relume_api::NerfstudioWorld;
use relume_api::problem::FieldError;
use relume_capture::{ImportLimits, Up, cameras_of_colmap};
use relume_train::render::{FrameView, resized};

/// Maximum number of frames in a file.
const MAX_FRAMES: usize = 100_000;

/// Reads the views of the file or folder at `path`. A COLMAP model and a `transforms.json` are rotated as the
/// capture of the rendered model, with its `up`.
///
/// # Errors
/// The error names the file and the invalid field.
pub(super) fn read(path: &Path, args: &CameraArgs, up: Up) -> Result<Vec<FrameView>, String> {
    let named = |error: String| format!("{}: {error}", path.display());
    if path.is_dir() {
        let cameras = cameras_of_colmap(path, &ImportLimits::default(), up);
        let cameras = cameras.map_err(|e| named(e.to_string()))?;
        return sized(cameras.iter().map(photo_view).collect(), args).map_err(named);
    }
    let bytes = input::read(path)?;
    let world = args.path_world.as_deref().map(read_world).transpose()?;
    sized(parse(&bytes, args, world.as_ref(), up).map_err(named)?, args).map_err(named)
}

/// Reads a `dataparser_transforms.json`.
fn read_world(file: &Path) -> Result<NerfstudioWorld, String> {
    let named = |error: String| format!("{}: {error}", file.display());
    let json = serde_json::from_slice(&input::read(file)?).map_err(|error| named(error.to_string()))?;
    let world: NerfstudioWorld = input::from_json(json).map_err(named)?;
    world.check().map_err(named)?;
    Ok(world)
}

/// Parses the views of a JSON file of any supported kind.
fn parse(
    bytes: &[u8],
    args: &CameraArgs,
    world: Option<&NerfstudioWorld>,
    up: Up,
) -> Result<Vec<FrameView>, String> {
    let json: Value = serde_json::from_slice(bytes).map_err(|error| format!("is not valid JSON: {error}"))?;
    if world.is_some() && json.get("camera_path").is_none() {
        return Err("--path-world can only be used with a file that has a camera_path".to_owned());
    }
    let size = args.resolution.unwrap_or((args.size, args.size));
    path_views(&json, size, world, up).map_err(|error| named_as_in_code(&error))
}

/// The field and the detail of an error, with the field as in code, e.g. `cameras[0].camera`.
fn named_as_in_code(error: &FieldError) -> String {
    let mut name = String::new();
    for part in error.pointer.split('/').skip(1) {
        match part.parse::<usize>() {
            Ok(index) => name.push_str(&format!("[{index}]")),
            Err(_) if name.is_empty() => name.push_str(part),
            Err(_) => name.push_str(&format!(".{part}")),
        }
    }
    if name.is_empty() { error.detail.clone() } else { format!("{name}: {}", error.detail) }
}

/// The views at the requested resolution.
fn sized(views: Vec<FrameView>, args: &CameraArgs) -> Result<Vec<FrameView>, String> {
    if !(1..=MAX_FRAMES).contains(&views.len()) {
        return Err(format!("has {} cameras; must have 1 to {MAX_FRAMES}", views.len()));
    }
    let Some(size) = args.resolution else { return Ok(views) };
    resized(views, size).map_err(|(i, why)| format!("camera {} {why}", i + 1))
}

#[cfg(test)]
mod tests {
    use super::*;
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

    fn views(json: &Value, resolution: Option<(u32, u32)>) -> Result<Vec<FrameView>, String> {
        let args = args(resolution);
        sized(parse(json.to_string().as_bytes(), &args, None, Up::AUTO)?, &args)
    }

    #[test]
    fn resolution_scales_cameras_but_keeps_the_aspect_ratio() {
        let file = json!({ "width": 64, "height": 48, "cameras": [{ "light_rotation_deg": 30,
            "camera": { "look_at": { "eye": [3, 0, 0], "target": [0, 0, 0], "fov_y_deg": 40 } } }] });
        let small = views(&file, None).unwrap()[0];
        let large = views(&file, Some((128, 96))).unwrap()[0];
        assert_eq!((large.camera.width, large.camera.height, large.light_rotation_deg), (128, 96, 30.0));
        assert!((large.camera.fy - 2.0 * small.camera.fy).abs() < 1e-9);
        assert!(views(&file, Some((128, 128))).unwrap_err().contains("aspect ratio"));
    }

    #[test]
    fn invalid_camera_files_are_refused_with_the_field_name() {
        let look = json!({ "look_at": { "eye": [3, 0, 0], "target": [3, 0, 0], "fov_y_deg": 40 } });
        for (file, word) in [
            (json!({}), "camera_path"),
            (json!({ "cameras": [] }), "has 0 cameras"),
            (json!({ "cameras": [{ "camera": {} }] }), "cameras[0].camera: must have exactly one of"),
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
