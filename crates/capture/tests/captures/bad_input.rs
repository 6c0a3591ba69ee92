//! Bad values inside a well-formed archive: each gets a refusal that names the file and the field.

use serde_json::json;

use relume_capture::CaptureError;
use relume_fixtures::small_set::{
    Files, blender, colmap, import_bytes, import_folder, nerfstudio, picture, pose_with_entry, transforms,
    zip,
};

fn refusal(files: &Files) -> CaptureError {
    import_bytes(&zip(files)).unwrap_err()
}

/// The blender set with its JSON replaced by text.
fn with_json(text: &str) -> Files {
    let mut files = blender();
    files.insert("transforms_train.json".into(), text.into());
    files
}

fn with_pose(pose: serde_json::Value) -> Files {
    let mut set = transforms(4);
    set["frames"][2]["transform_matrix"] = pose;
    with_json(&set.to_string())
}

fn with_image(bytes: &[u8]) -> Files {
    let mut files = blender();
    files.insert("train/r_1.png".into(), bytes.to_vec());
    files
}

#[test]
fn undecodable_images_are_refused_by_name() {
    let cut = picture(1);
    for (bytes, says) in [
        (&b""[..], "empty"),
        (b"This is a text, not a picture.", "not a PNG"),
        (&cut[..cut.len() - 20], "cannot be decoded"),
    ] {
        let error = refusal(&with_image(bytes));
        assert_eq!((error.code(), error.file()), ("capture_image_invalid", Some("train/r_1.png")));
        assert!(error.to_string().contains(says), "{error}");
    }
}

#[test]
fn header_of_400_million_pixels_is_refused_before_decoding() {
    let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR".to_vec();
    png.extend([0, 0, 0x4e, 0x20, 0, 0, 0x4e, 0x20, 8, 6, 0, 0, 0, 0, 0, 0, 0]);
    let error = refusal(&with_image(&png));
    assert_eq!((error.code(), error.file()), ("capture_over_limit", Some("train/r_1.png")), "{error}");
    let mut options = relume_capture::ImportOptions::default();
    options.limits.max_total_pixels = u64::MAX;
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), zip(&with_image(&png))).unwrap();
    let error = relume_capture::import(file.path(), &options).unwrap_err();
    assert_eq!((error.code(), error.field()), ("capture_over_limit", Some("max_image_pixels")));
    assert!(error.to_string().contains("20000x20000"), "{error}");
}

#[test]
fn invalid_poses_are_refused_by_frame() {
    let zero = json!([[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1]]);
    let flat = json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1]]);
    let mirrored = json!([[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]);
    let sheared = json!([[1, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]);
    let (small, last) = (json!([[1, 0], [0, 1]]), [(2, json!(0.5)), (3, json!(0)), (3, json!(-1))]);
    let last = last.map(|(column, value)| pose_with_entry(3, column, value));
    for pose in [zero, flat, mirrored, sheared, small, json!([])].into_iter().chain(last) {
        let error = refusal(&with_pose(pose.clone()));
        assert_eq!(error.code(), "capture_field_invalid", "{pose}: {error}");
        assert_eq!(error.file(), Some("transforms_train.json"));
        assert_eq!(error.field(), Some("frames[2].transform_matrix"), "{pose}");
    }
}

#[test]
fn python_nan_literal_is_refused_with_file_and_field() {
    let text = with_pose(pose_with_entry(0, 3, json!("NAN")))["transforms_train.json"].clone();
    let text = String::from_utf8(text).unwrap().replace("\"NAN\"", "NaN");
    let error = refusal(&with_json(&text));
    assert_eq!((error.file(), error.field()), (Some("transforms_train.json"), Some("transform_matrix")));
    assert!(error.to_string().contains("NaN"), "{error}");
}

#[test]
fn missing_and_invalid_intrinsics_are_refused_by_field() {
    let mut set = transforms(4);
    set.as_object_mut().unwrap().remove("camera_angle_x");
    let error = refusal(&with_json(&set.to_string()));
    assert_eq!((error.file(), error.field()), (Some("transforms_train.json"), Some("fl_x")));
    for (key, value, field) in [
        ("fl_x", json!(-3.0), "fl_x,fl_y"),
        ("w", json!(0), "w,h"),
        ("w", json!(600), "w,h"),
        ("k1", json!(-1e9), "frames[0].k1"),
        ("camera_model", json!("EQUIRECTANGULAR"), "frames[0].camera_model"),
    ] {
        let error = refusal(&nerfstudio(|set| set[key] = value));
        assert_eq!((error.file(), error.field()), (Some("transforms.json"), Some(field)), "{error}");
    }
}

#[test]
fn invalid_light_rotation_is_refused() {
    for turn in ["\"north\"", "NaN", "1e999"] {
        let mut set = transforms(4);
        set["frames"][2]["light_rotation_deg"] = json!("TURN");
        let error = refusal(&with_json(&set.to_string().replace("\"TURN\"", turn)));
        assert_eq!(error.file(), Some("transforms_train.json"), "{turn}: {error}");
        assert!(error.field().is_some_and(|f| f.contains("light_rotation_deg")), "{turn}: {error}");
        let named = error.field() == Some("frames[2].light_rotation_deg");
        assert!(named || error.to_string().contains("column"), "{error}");
    }
}

#[test]
fn json_of_another_schema_is_refused_by_field() {
    for (text, field) in [
        ("{}", Some("frames")),
        ("{\"frames\": 3}", Some("frames")),
        ("{\"frames\": [{}]}", Some("frames[0].file_path")),
        ("[1, 2", None),
        ("", None),
    ] {
        let error = refusal(&with_json(text));
        assert_eq!((error.file(), error.field()), (Some("transforms_train.json"), field), "{text}: {error}");
    }
    let escape = json!({"camera_angle_x": 0.7, "frames": [{"file_path": "../../x", "transform_matrix": []}]});
    assert_eq!(refusal(&with_json(&escape.to_string())).field(), Some("frames[0].file_path"));
}

#[test]
fn too_few_images_are_refused_with_count_and_names() {
    let error = refusal(&with_json(&transforms(1).to_string()));
    assert!(matches!(error, CaptureError::TooFewImages { usable: 1, required: 3, .. }), "{error}");
    let mut files = blender();
    files.remove("train/r_1.png");
    let capture = import_bytes(&zip(&files)).unwrap();
    assert!(capture.warnings[0].ends_with("names: 1 of 4: train/r_1"));
    files.remove("train/r_2.png");
    let error = refusal(&files);
    assert_eq!(error.code(), "capture_too_few_images");
    assert!(
        error.to_string().contains("usable photographs: 2") && error.to_string().contains("train/r_2"),
        "{error}"
    );
}

#[test]
fn folder_without_photographs_says_what_to_put_there() {
    for files in [Files::new(), Files::from([("notes.txt".to_owned(), b"hello".to_vec())])] {
        let error = import_folder(&files).unwrap_err();
        assert_eq!(error.code(), "capture_layout_unknown");
        let text = error.to_string();
        assert!(text.contains("put at least 3 photographs into it") && text.contains("JPEG"), "{text}");
        assert!(!text.contains("relume train"), "the advice must not be the failed command: {text}");
        assert_eq!(text.contains("its first files are notes.txt"), !files.is_empty(), "{text}");
    }
    let photographs: Files = (0..4).map(|i| (format!("{i}.png"), picture(i))).collect();
    let text = import_folder(&photographs).unwrap_err().to_string();
    assert!(text.contains("relume capture poses") && !text.contains("put at least"), "the control: {text}");
}

#[test]
fn missing_mask_file_is_refused() {
    let error = refusal(&nerfstudio(|set| set["frames"][1]["mask_path"] = json!("masks/1.png")));
    assert_eq!((error.code(), error.file()), ("capture_file_invalid", Some("masks/1.png")));
}

#[test]
fn invalid_colmap_values_are_refused_by_file_and_entry() {
    for (file, from, to, field) in [
        ("cameras.txt", "PINHOLE", "FULL_OPENCV", Some("cameras[1].params")),
        ("cameras.txt", "PINHOLE", "LOMO", Some("cameras[1].model")),
        ("cameras.txt", "1 PINHOLE", "9 PINHOLE", Some("images[0.png].camera_id")),
        ("images.txt", "0.png", "", Some("line 2")),
        ("points3D.txt", "0.5", "NaN", Some("points3D[1].xyz")),
    ] {
        let mut files = colmap();
        let path = format!("sparse/0/{file}");
        let text = String::from_utf8(files[&path].clone()).unwrap();
        files.insert(path, text.replacen(from, to, 1).into_bytes());
        let error = refusal(&files);
        assert_eq!(error.field(), field, "{file}: {error}");
    }
    let mut binary = colmap();
    binary.insert("sparse/0/cameras.bin".into(), u64::MAX.to_le_bytes().to_vec());
    binary.insert("sparse/0/images.bin".into(), u64::MAX.to_le_bytes().to_vec());
    let error = refusal(&binary);
    assert_eq!((error.code(), error.file()), ("capture_file_invalid", Some("sparse/0/cameras.bin")));
}

#[test]
fn pointers_and_web_pages_in_the_place_of_files_are_named() {
    let pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 12\n".to_vec();
    let page = b"<!DOCTYPE html><html><body>404</body></html>".to_vec();
    let heic = b"\0\0\0\x18ftypheic\0\0\0\0mif1heic".to_vec();
    for (file, bytes, word) in [
        ("images/2.png", pointer.clone(), "git lfs pull"),
        ("images/2.png", page.clone(), "web page"),
        ("images/2.png", heic, "HEIC"),
        ("transforms.json", pointer, "git lfs pull"),
        ("transforms.json", page, "web page"),
    ] {
        let mut files = nerfstudio(|_| ());
        files.insert(file.to_owned(), bytes);
        let error = import_folder(&files).unwrap_err();
        assert_eq!(error.file(), Some(file), "{word}");
        assert!(error.to_string().contains(word), "{error}");
    }
}
