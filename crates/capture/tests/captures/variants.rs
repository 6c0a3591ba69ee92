//! Captures as many programs and people store them: other folders, names, encodings and spellings. Each is understood, or refused
//! in words that name the cause.

use glam::{DQuat, DVec3};
use relume_capture::{Capture, CaptureError, ImportOptions, import};
use relume_compare::largest_difference;
use relume_fixtures::small_set::{
    Files, blender, camera, colmap, import_folder, nerfstudio, polycam, pose, pose_error,
};
use relume_scene::Camera;
use relume_spec::training::UpAxis;
use serde_json::{Value, json};

/// The files with other paths.
fn moved(files: &Files, path: impl Fn(&str) -> String) -> Files {
    files.iter().map(|(name, bytes)| (path(name), bytes.clone())).collect()
}

/// The cameras of a capture by the name of the photograph without folders and extension.
fn cameras(capture: &Capture) -> Vec<(String, Camera)> {
    let stem = |name: &str| name.rsplit('/').next().unwrap().split('.').next().unwrap().to_owned();
    let views = capture.train.iter().chain(&capture.test);
    let mut cameras: Vec<_> = views.map(|view| (stem(&view.name), view.camera)).collect();
    cameras.sort_by(|a, b| a.0.cmp(&b.0));
    cameras
}

/// The warnings of a capture with the same cameras as `reference`.
fn same_cameras(files: &Files, reference: &Files) -> Vec<String> {
    let capture = import_folder(files).unwrap();
    assert_eq!(cameras(&capture), cameras(&import_folder(reference).unwrap()));
    capture.warnings
}

fn refusal(files: &Files) -> String {
    import_folder(files).unwrap_err().to_string()
}

#[test]
fn photographs_under_other_names_are_used_with_a_warning() {
    let set = nerfstudio(|_| ());
    let upper = |name: &str| name.replace("images/", "Images/").replace(".png", ".PNG");
    for (what, files) in [
        ("another case", moved(&set, upper)),
        ("another extension", moved(&set, |name| name.replace(".png", ".jpg"))),
        ("beside the JSON", moved(&set, |name| name.replace("images/", ""))),
        ("another folder", moved(&set, |name| name.replace("images/", "photos/left/"))),
    ] {
        let warnings = same_cameras(&files, &set);
        assert!(
            warnings.len() == 1 && warnings[0].contains("found by their names: 6"),
            "{what}: {warnings:?}"
        );
    }
    for prefix in ["C:\\scan\\images\\", "/home/me/scan/images/", "images\\"] {
        let files = nerfstudio(|set| {
            let frames = set["frames"].as_array_mut().unwrap();
            let name = |i: usize| json!(format!("{prefix}{i}.png"));
            frames.iter_mut().enumerate().for_each(|(i, frame)| frame["file_path"] = name(i));
        });
        same_cameras(&files, &set);
    }
    assert_eq!(same_cameras(&set, &set), [""; 0], "the control");
    let none = moved(&set, |name| name.replace("images/", "images/view_"));
    assert!(refusal(&none).contains("usable photographs: 0"), "the control: other names");
}

#[test]
fn sets_in_other_folders_or_of_other_names_are_found() {
    let (synthetic, studio) = (blender(), nerfstudio(|_| ()));
    let beside = |files: &Files, name: &str| {
        let mut files = files.clone();
        files.insert(name.to_owned(), b"text".to_vec());
        files
    };
    let deep = |files: &Files| beside(&moved(files, |name| format!("data/lego/{name}")), "README.txt");
    assert_eq!(same_cameras(&deep(&synthetic), &synthetic), [""; 0]);
    assert_eq!(same_cameras(&deep(&studio), &studio), [""; 0]);
    let renamed = moved(&studio, |name| name.replace("transforms.json", "transforms_1.json"));
    assert_eq!(same_cameras(&renamed, &studio), [""; 0]);
    let test = moved(&synthetic, |name| name.replace("transforms_train", "transforms_test"));
    assert!(refusal(&test).starts_with("transforms_train.json: is missing beside transforms_test.json"));
    let mut two = renamed.clone();
    two.insert("transforms_2.json".to_owned(), two["transforms_1.json"].clone());
    assert!(refusal(&two).contains("several captures; keep one of transforms_1.json, transforms_2.json"));
}

#[test]
fn colmap_models_are_found_wherever_programs_store_them() {
    let set = colmap();
    for folder in
        ["sparse/", "sparse/1/", "dense/sparse/", "colmap/sparse/", "sfm/", "colmap/text/", "a/b/", "model/"]
    {
        let files = moved(&set, |name| name.replace("sparse/0/", folder));
        assert_eq!(same_cameras(&files, &set), [""; 0], "{folder}");
    }
    let undistorted =
        moved(&set, |name| name.replace("sparse/0/", "dense/sparse/").replace("images/", "dense/images/"));
    assert_eq!(same_cameras(&undistorted, &set), [""; 0]);
    let mut several = set.clone();
    several.extend(moved(&set, |name| name.replace("sparse/0/", "sparse/1/")));
    let images = String::from_utf8(set["sparse/0/images.txt"].clone()).unwrap();
    let two: String = images.lines().take(5).map(|line| format!("{line}\n")).collect();
    several.insert("sparse/0/images.txt".to_owned(), two.into_bytes());
    let warnings = same_cameras(&several, &set);
    let expected = "COLMAP made several models; sparse/1/ with 4 images is used, not used: sparse/0/ with 2";
    assert_eq!(warnings, [expected]);
}

#[test]
fn colmap_text_is_read_without_empty_lines_and_in_utf16() {
    let set = colmap();
    let text = |name: &str| String::from_utf8(set[name].clone()).unwrap();
    let with = |name: &str, bytes: Vec<u8>| {
        let mut files = set.clone();
        files.insert(name.to_owned(), bytes);
        files
    };
    let images = text("sparse/0/images.txt");
    let compact: String =
        images.lines().filter(|line| !line.is_empty()).map(|line| format!("{line}\n")).collect();
    assert_eq!(same_cameras(&with("sparse/0/images.txt", compact.into_bytes()), &set), [""; 0]);
    let observed = images.replace("\n\n", "\n1.5 2.5 -1 3.5 4.5 7\n");
    assert_eq!(same_cameras(&with("sparse/0/images.txt", observed.into_bytes()), &set), [""; 0]);
    let marked = [b"\xef\xbb\xbf", text("sparse/0/cameras.txt").replace('\n', "\r\n").as_bytes()].concat();
    assert_eq!(same_cameras(&with("sparse/0/cameras.txt", marked), &set), [""; 0]);
    let wide = std::iter::once(0xfeff).chain(images.encode_utf16()).flat_map(u16::to_le_bytes).collect();
    assert_eq!(same_cameras(&with("sparse/0/images.txt", wide), &set), [""; 0]);
}

#[test]
fn colmap_camera_models_are_read_or_refused_by_name() {
    let with = |line: &str| {
        let mut files = colmap();
        files.insert("sparse/0/cameras.txt".to_owned(), format!("1 {line}\n").into_bytes());
        import_folder(&files)
    };
    let pinhole = cameras(&import_folder(&colmap()).unwrap());
    let focal = |capture: &Capture| cameras(capture)[0].1.fx;
    for model in [
        "FULL_OPENCV 8 6 9 9.5 4 3 0 0 0 0 0 0 0 0",
        "FOV 8 6 9 9.5 4 3 1e-9",
        "OPENCV 8 6 9 9.5 4 3 0 0 0 0",
    ] {
        let found = cameras(&with(model).unwrap());
        for ((_, found), (_, expected)) in found.iter().zip(&pinhole) {
            let values = |c: &Camera| [c.fx, c.fy, c.cx, c.cy];
            assert!(largest_difference(&values(found), &values(expected)) < 1e-6, "{model}");
        }
    }
    for model in [
        "FULL_OPENCV 8 6 9 9.5 4 3 0.2 0 0 0 0 0 0 0",
        "FOV 8 6 9 9.5 4 3 0.8",
        "SIMPLE_FISHEYE 8 6 9 4 3",
        "SIMPLE_RADIAL_FISHEYE 8 6 9 4 3 0.1",
        "RADIAL_FISHEYE 8 6 9 4 3 0.1 0.01",
        "THIN_PRISM_FISHEYE 8 6 9 9.5 4 3 0.1 0 0 0 0 0 0.01 0",
        "RAD_TAN_THIN_PRISM_FISHEYE 8 6 9 9.5 4 3 0.1 0 0 0 0 0 0 0 0 0 0 0",
    ] {
        let capture = with(model).unwrap_or_else(|error| panic!("{model}: {error}"));
        assert!((focal(&capture) - 9.0).abs() > 1e-3, "{model} bends the image: {}", focal(&capture));
    }
    for (line, reason) in [
        ("EQUIRECTANGULAR 8 6 8 6", "EQUIRECTANGULAR is not supported; run `colmap image_undistorter`"),
        ("PINHOLE 8 6 9 9.5 4", "PINHOLE has 4 parameters, not 3"),
        ("LOMO 8 6 9", "the camera model LOMO is unknown"),
    ] {
        let error = with(line).unwrap_err().to_string();
        assert!(error.contains(reason) && error.contains("cameras[1]"), "{error}");
    }
}

/// A nerfstudio set whose first frame is changed by `edit`.
fn with_frame(edit: impl FnOnce(&mut Value)) -> Result<Capture, CaptureError> {
    import_folder(&nerfstudio(|set| edit(&mut set["frames"][0])))
}

#[test]
fn matrices_of_other_shapes_are_read_or_refused_with_the_cause() {
    let rows = json!(pose(0));
    let flat: Vec<f64> = pose(0).concat();
    let doubled: Vec<Vec<f64>> = pose(0).iter().map(|row| row.iter().map(|v| 2.0 * v).collect()).collect();
    let text: Vec<Vec<String>> = pose(0).iter().map(|row| row.iter().map(f64::to_string).collect()).collect();
    for matrix in [rows, json!(flat), json!(doubled), json!(text), json!(&pose(0)[..3])] {
        let capture = with_frame(|frame| frame["transform_matrix"] = matrix.clone()).unwrap();
        assert!(pose_error(&cameras(&capture)[0].1, 0) < 1e-9, "{matrix}");
    }
    let transposed: Vec<Vec<f64>> = (0..4).map(|i| pose(0).iter().map(|row| row[i]).collect()).collect();
    for (matrix, reason) in [
        (json!(transposed), "looks transposed"),
        (json!(null), "is missing"),
        (json!([[1, 0], [0, 1]]), "4x4 or 3x4"),
        (json!("pose"), "must be a list"),
    ] {
        let error = with_frame(|frame| frame["transform_matrix"] = matrix.clone()).unwrap_err();
        assert_eq!(error.field(), Some("frames[0].transform_matrix"));
        assert!(error.to_string().contains(reason), "{matrix}: {error}");
    }
}

#[test]
fn intrinsics_are_read_as_strings_and_matrices() {
    let set = nerfstudio(|_| ());
    let strings = nerfstudio(|set| set["fl_x"] = json!("9.0"));
    assert_eq!(same_cameras(&strings, &set), [""; 0]);
    let matrix = nerfstudio(|set| {
        let fields = set.as_object_mut().unwrap();
        ["fl_x", "fl_y", "cx", "cy"].iter().for_each(|name| drop(fields.remove(*name)));
        fields["frames"].as_array_mut().unwrap().iter_mut().for_each(|frame| {
            frame["K"] = json!([[9.0, 0, 4.0], [0, 9.5, 3.0], [0, 0, 1]]);
        });
    });
    assert_eq!(same_cameras(&matrix, &set), [""; 0]);
    let error = import_folder(&nerfstudio(|set| set["frames"][2]["fl_x"] = json!("long"))).unwrap_err();
    assert_eq!(error.to_string(), "transforms.json: frames[2].fl_x: must be a number");
    let marked = |mark: &[u8]| {
        let mut files = nerfstudio(|_| ());
        let json = files["transforms.json"].clone();
        files.insert("transforms.json".to_owned(), [mark, &json].concat());
        files
    };
    assert_eq!(same_cameras(&marked(b"\xef\xbb\xbf"), &set), [""; 0], "a byte order mark");
    assert!(refusal(&marked(b"\xff")).contains("not UTF-8"), "the control");
}

/// The world of a set after a rotation of all its poses, and its warnings.
fn with_rotation(rotation: DQuat, up: UpAxis) -> (Vec<(String, Camera)>, Vec<String>) {
    let files = nerfstudio(|set| {
        for (i, frame) in set["frames"].as_array_mut().unwrap().iter_mut().enumerate() {
            let pose = glam::DMat4::from_quat(rotation) * camera(i).to_opengl();
            frame["transform_matrix"] = json!(pose.transpose().to_cols_array_2d());
        }
    });
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("images")).unwrap();
    files.iter().for_each(|(name, bytes)| std::fs::write(folder.path().join(name), bytes).unwrap());
    let capture =
        import(folder.path(), &ImportOptions { up: up.into(), ..ImportOptions::default() }).unwrap();
    (cameras(&capture), capture.warnings)
}

#[test]
fn worlds_with_y_up_are_reported_and_rotated_on_request() {
    let y_up = DQuat::from_rotation_arc(DVec3::Z, DVec3::Y);
    let error = |cameras: &[(String, Camera)]| {
        let errors = cameras.iter().enumerate().map(|(i, (_, camera))| pose_error(camera, i));
        relume_compare::worst(errors)
    };
    let (kept, warnings) = with_rotation(y_up, UpAxis::Auto);
    assert!(error(&kept) > 0.1 && warnings.len() == 1, "{warnings:?}");
    assert!(warnings[0].ends_with("probably +Y is up: train with --up y"), "{warnings:?}");
    let (stated, warnings) = with_rotation(y_up, UpAxis::Y);
    assert!(error(&stated) < 1e-9 && warnings.is_empty(), "{warnings:?}");
}

#[test]
fn polycams_raw_folder_is_read() {
    let mut files = polycam();
    let capture = import_folder(&files).unwrap();
    assert_eq!((capture.layout.as_str(), cameras(&capture).len()), ("polycam", 6));
    for (i, (_, camera)) in cameras(&capture).iter().enumerate() {
        assert!(pose_error(camera, i) < 1e-9 && pose_error(camera, i + 1) > 0.1);
    }
    files.insert("keyframes/cameras/2.json".to_owned(), b"{\"fx\": 9}".to_vec());
    assert_eq!(refusal(&files), "cameras/2.json: t_20: is missing");
}
