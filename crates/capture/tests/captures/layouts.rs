//! Every layout: recognition, cameras, and held-out photographs.

use glam::DVec3;
use relume_spec::training::UpAxis;
use serde_json::json;

use relume_capture::formats::image_file;
use relume_capture::{
    Capture, CaptureView, ImportLimits, ImportOptions, UndecodedCapture, cameras, import, inspect,
};
use relume_fixtures::small_set::{
    Files, blender, camera, colmap, import_bytes, import_folder, nerfstudio, pose_error, transforms, zip,
};

fn view<'a>(capture: &'a Capture, name: &str) -> &'a CaptureView {
    capture.train.iter().chain(&capture.test).find(|v| v.name == name).unwrap()
}

/// Pixel of a world point.
fn project(view: &CaptureView, p: DVec3) -> (f64, f64) {
    let c = &view.camera;
    let p = c.rotation * p + c.translation;
    (c.fx * p.x / p.z + c.cx, c.fy * p.y / p.z + c.cy)
}

#[test]
fn blender_set_keeps_poses_and_holds_out_every_eighth_image() {
    let capture = import_folder(&blender()).unwrap();
    assert_eq!((capture.layout.as_str(), capture.train.len(), capture.test.len()), ("nerf-synthetic", 3, 1));
    assert_eq!(capture.test[0].name, "train/r_0.png");
    assert!(capture.has_alpha);
    for i in 0..4 {
        let view = view(&capture, &format!("train/r_{i}.png"));
        assert!(pose_error(&view.camera, i) < 1e-9);
        assert!(pose_error(&view.camera, i + 1) > 0.1, "the comparison can fail");
        assert!((view.image.pixel(9)[0] - i as f32 * 10.0 / 255.0).abs() < 1e-6);
    }
}

#[test]
fn photographs_of_the_memory_estimate_are_decoded_once() {
    let folder = tempfile::TempDir::new().unwrap();
    for (name, bytes) in &blender() {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
    let whole = import(folder.path(), &ImportOptions::default()).unwrap();
    let mut undecoded = UndecodedCapture::open(folder.path(), &ImportOptions::default()).unwrap();
    assert!(undecoded.bytes_a_pixel().unwrap() > 0.0);
    for decoded in ["train/r_0.png", "train/r_2.png", "train/r_3.png"] {
        std::fs::remove_file(folder.path().join(decoded)).unwrap();
    }
    let views = |capture: &Capture| -> Vec<_> {
        capture
            .train
            .iter()
            .chain(&capture.test)
            .map(|v| (v.name.clone(), v.image.decoded().pixels))
            .collect()
    };
    assert_eq!(views(&undecoded.decode().unwrap()), views(&whole));
    let other = UndecodedCapture::open(folder.path(), &ImportOptions::default());
    assert!(other.and_then(UndecodedCapture::decode).is_err(), "the control: the photographs are gone");
}

#[test]
fn imported_camera_projects_points_ahead_above_and_right() {
    let capture = import_folder(&blender()).unwrap();
    let view = view(&capture, "train/r_2.png");
    let (u, v) = project(view, DVec3::ZERO);
    assert!((u - 4.0).abs() < 1e-9 && (v - 3.0).abs() < 1e-9);
    assert!(project(view, DVec3::Z * 0.2).1 < 2.9, "rows grow downwards");
    let right = view.camera.rotation.row(0);
    assert!(project(view, right * 0.2).0 > 4.1, "columns grow to the right");
}

#[test]
fn transforms_test_file_defines_the_held_out_images() {
    let mut files = blender();
    let mut test = transforms(2);
    test["frames"].as_array_mut().unwrap().remove(0);
    files.insert("transforms_test.json".into(), test.to_string().into_bytes());
    let capture = import_bytes(&zip(&files)).unwrap();
    assert_eq!((capture.train.len(), capture.test.len()), (3, 1), "a held-out photograph is not trained on");
    assert_eq!(capture.test[0].name, "train/r_1.png");
    assert!(capture.train.iter().all(|view| view.name != "train/r_1.png"));
}

#[test]
fn nerfstudio_intrinsics_may_be_shared_or_per_frame() {
    let capture = import_folder(&nerfstudio(|set| {
        set["frames"][2]["fl_x"] = json!(11.0);
        set["test_filenames"] = json!(["./images/5.png"]);
    }))
    .unwrap();
    assert_eq!((capture.layout.as_str(), capture.train.len(), capture.test.len()), ("nerfstudio", 5, 1));
    assert_eq!(capture.test[0].name, "images/5.png");
    assert_eq!(view(&capture, "images/2.png").camera.fx, 11.0);
    assert_eq!(
        (view(&capture, "images/1.png").camera.fx, view(&capture, "images/1.png").camera.fy),
        (9.0, 9.5)
    );
    assert!(pose_error(&view(&capture, "images/3.png").camera, 3) < 1e-9);
}

#[test]
fn light_rotation_is_read_from_frames() {
    let mut set = transforms(4);
    set["frames"][2]["light_rotation_deg"] = json!(-120);
    let mut files = blender();
    files.insert("transforms_train.json".into(), set.to_string().into_bytes());
    let turned = import_folder(&files).unwrap();
    assert_eq!(view(&turned, "train/r_2.png").light_rotation_deg, -120.0);
    assert_eq!(view(&turned, "train/r_1.png").light_rotation_deg, 0.0);
    let turned =
        import_folder(&nerfstudio(|set| set["frames"][1]["light_rotation_deg"] = json!(7.5))).unwrap();
    assert_eq!(view(&turned, "images/1.png").light_rotation_deg, 7.5);
    assert_eq!(view(&turned, "images/2.png").light_rotation_deg, 0.0);
}

#[test]
fn mask_file_becomes_alpha() {
    let mut files = nerfstudio(|set| set["frames"][1]["mask_path"] = json!("masks/1.png"));
    let half: Vec<[u8; 1]> = (0..48u8).map(|i| [if i % 8 < 4 { 0 } else { 255 }]).collect();
    files.insert("masks/1.png".into(), image_file::encode_png(8, 6, &half).unwrap());
    let capture = import_folder(&files).unwrap();
    let masked = view(&capture, "images/1.png");
    assert!((0..48).all(|i| masked.image.pixel(i)[3] == f32::from(u8::from(i % 8 >= 4))));
}

#[test]
fn masks_are_found_by_file_name() {
    let half: Vec<[u8; 1]> = (0..48u8).map(|i| [if i % 8 < 4 { 0 } else { 255 }]).collect();
    let half = image_file::encode_png(8, 6, &half).unwrap();
    let is_masked = |view: &CaptureView| view.image.pixel(2)[3] == 0.0 && view.image.pixel(6)[3] == 1.0;
    for (files, mask) in [
        (nerfstudio(|_| {}), "images/1_mask.png"),
        (nerfstudio(|_| {}), "masks/1.png"),
        (colmap(), "images/1_mask.png"),
        (colmap(), "masks/1.png.png"),
        (colmap(), "mask/1.png"),
    ] {
        let mut files = files;
        files.insert(mask.to_owned(), half.clone());
        let capture = import_folder(&files).unwrap();
        assert!(is_masked(view(&capture, "images/1.png")), "{mask}");
        assert!(!is_masked(view(&capture, "images/2.png")), "{mask}: the control");
    }
}

#[test]
fn photograph_is_rotated_by_exif_if_its_poses_need_it() {
    // Bright on the left as stored, 6 x 8 pixels; orientation 6 turns that to the top.
    let pixels: Vec<[u8; 3]> = (0..48).map(|i| [if i % 6 < 3 { 250 } else { 5 }; 3]).collect();
    let jpeg = image_file::encode_jpeg(6, 8, &pixels, 95).unwrap();
    let exif = b"\xff\xe1\0\x22Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
    let turned = [&jpeg[..2], exif, &jpeg[2..]].concat();
    let mut files = nerfstudio(|set| set["frames"][1]["file_path"] = json!("images/1.jpg"));
    files.insert("images/1.jpg".into(), turned);
    let capture = import_folder(&files).unwrap();
    let seen = view(&capture, "images/1.jpg");
    assert_eq!((seen.image.width, seen.image.height, seen.camera.width), (8, 6, 8));
    assert!(seen.image.pixel(3)[0] > 0.8 && seen.image.pixel(44)[0] < 0.2, "bright above");
    files.insert("images/1.jpg".into(), jpeg);
    let refused = import_folder(&files).unwrap_err();
    assert_eq!(refused.field(), Some("w,h"), "the control: nothing says that it is turned");
}

#[test]
fn colmap_model_directly_in_sparse_is_read() {
    let moved = |(name, bytes): (String, Vec<u8>)| (name.replace("sparse/0/", "sparse/"), bytes);
    let here: Files = colmap().into_iter().map(moved).collect();
    let there = import_folder(&colmap()).unwrap();
    assert_eq!(import_folder(&here).unwrap(), there);
    let lost: Files = colmap().into_iter().map(|(n, b)| (n.replace("images.txt", "views.txt"), b)).collect();
    assert!(import_folder(&lost).is_err(), "the control");
}

#[test]
fn point_cloud_is_read_and_a_missing_one_gives_a_warning() {
    let mut files = nerfstudio(|set| set["ply_file_path"] = json!("points.ply"));
    let missing = import_folder(&files).unwrap();
    assert!(missing.points.is_empty() && missing.warnings[0].contains("points.ply"));
    let ply = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
        end_header\n1 2 3\n";
    files.insert("points.ply".into(), ply.into());
    assert_eq!(import_folder(&files).unwrap().points, [(DVec3::new(1.0, 2.0, 3.0), [0.5; 3])]);
}

#[test]
fn import_removes_lens_distortion() {
    let bent = import_folder(&nerfstudio(|set| set["k1"] = json!(-0.2))).unwrap();
    let straight = import_folder(&nerfstudio(|_| {})).unwrap();
    let (a, b) = (view(&bent, "images/1.png"), view(&straight, "images/1.png"));
    assert!(a.camera.fx < 0.98 * b.camera.fx, "a barrel sees a wider field: {}", a.camera.fx);
    assert_ne!(a.image, b.image);
    let fisheye = |set: &mut serde_json::Value| set["camera_model"] = json!("OPENCV_FISHEYE");
    let fisheye = import_folder(&nerfstudio(fisheye)).unwrap();
    assert_ne!(view(&fisheye, "images/1.png").camera.fx, b.camera.fx);
}

#[test]
fn cameras_read_without_images_equal_the_imported_cameras() {
    let bent = nerfstudio(|set| set["k1"] = json!(-0.2));
    for (files, held_out) in [(blender(), 1), (bent, 1), (colmap(), 1)] {
        let archive = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(archive.path(), zip(&files)).unwrap();
        let capture = import(archive.path(), &ImportOptions::default()).unwrap();
        let alone = cameras(archive.path(), &ImportLimits::default(), UpAxis::Auto).unwrap();
        assert_eq!(alone.len(), capture.train.len() + capture.test.len());
        assert_eq!(alone.iter().filter(|camera| camera.is_held_out).count(), held_out);
        for camera in &alone {
            assert_eq!(camera.camera, view(&capture, &camera.name).camera, "{}", camera.name);
            assert_eq!(camera.is_held_out, capture.test.iter().any(|view| view.name == camera.name));
        }
    }
}

#[test]
fn colmap_scene_is_rotated_upright_with_unchanged_projections() {
    let capture = import_bytes(&zip(&colmap())).unwrap();
    assert_eq!((capture.layout.as_str(), capture.points.len()), ("colmap", 2));
    for i in 0..4 {
        let view = view(&capture, &format!("images/{i}.png"));
        let original = camera(i);
        let up = [view.camera, original].map(|camera| camera.rotation * DVec3::Z);
        assert!((up[0] - up[1]).length() < 1e-9, "{up:?}");
        let p = original.rotation * DVec3::new(0.5, 0.0, 0.0) + original.translation;
        let (u, v) = project(view, capture.points[1].0);
        assert!((u - (9.0 * p.x / p.z + 4.0)).abs() < 1e-9 && (v - (9.5 * p.y / p.z + 3.0)).abs() < 1e-9);
    }
    assert_eq!(capture.points[0].1, [1.0, 0.0, 0.0]);
}

#[test]
fn max_side_reduces_photographs_and_their_cameras() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("set.zip"), zip(&blender())).unwrap();
    let options = ImportOptions { max_side: Some(4), ..ImportOptions::default() };
    let capture = import(&folder.path().join("set.zip"), &options).unwrap();
    let camera = &capture.train[0].camera;
    assert_eq!((camera.width, camera.height, camera.cx), (4, 3, 2.0));
    assert_eq!((capture.train[0].image.width, capture.train[0].image.height), (4, 3));
}

#[test]
fn outer_folder_and_file_manager_files_are_ignored() {
    let mut files: Files = blender().into_iter().map(|(k, v)| (format!("my scan/lego/{k}"), v)).collect();
    files.insert("__MACOSX/my scan/._lego".into(), vec![0; 9]);
    files.insert("my scan/.DS_Store".into(), vec![0; 9]);
    let capture = import_bytes(&zip(&files)).unwrap();
    assert_eq!(capture.train.len() + capture.test.len(), 4);
}

#[test]
fn report_serialises_to_json_with_capture_facts() {
    let report = serde_json::to_value(import_folder(&blender()).unwrap().report()).unwrap();
    assert_eq!(report["layout"], "nerf-synthetic");
    assert_eq!((report["train_images"].as_u64(), report["width"].as_u64()), (Some(3), Some(8)));
    assert_eq!(
        (report["has_alpha"].as_bool(), report["has_ground_truth"].as_bool()),
        (Some(true), Some(false))
    );
}

#[test]
fn inspection_report_equals_the_import_report() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("set.zip");
    let wide: Vec<[u8; 3]> = vec![[90, 60, 30]; 160 * 120];
    let mut files = blender();
    for i in 0..4 {
        files.insert(format!("train/r_{i}.png"), image_file::encode_png(160, 120, &wide).unwrap());
    }
    std::fs::write(&path, zip(&files)).unwrap();
    let mut report = inspect(&path, &ImportOptions::default()).unwrap();
    let mut imported = import(&path, &ImportOptions::default()).unwrap().report();
    let notes = std::mem::take(&mut report.notes);
    assert!(notes.iter().any(|note| note.text.contains("are small")), "what an import does not look for");
    assert!((imported.radius - report.radius).abs() < 1e-9);
    imported.radius = report.radius;
    assert_eq!(report, imported);
    assert_eq!((report.width, report.height, report.has_alpha), (160, 120, false));
    files.insert("train/r_2.png".into(), b"no picture".to_vec());
    std::fs::write(&path, zip(&files)).unwrap();
    assert_eq!(inspect(&path, &ImportOptions::default()).unwrap_err().file(), Some("train/r_2.png"));
}
