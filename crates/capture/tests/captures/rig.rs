//! Poses that no real capture has are refused, or reported with numbers and the likely cause.

use glam::{DMat4, DVec3, DVec4};
use relume_capture::{Capture, CaptureError};
use relume_compare::{largest_difference, worst};
use relume_fixtures::small_set::{Files, import_folder, nerfstudio, picture, pose};
use relume_scene::Camera;
use serde_json::{Value, json};

/// A nerfstudio set of twelve photographs whose poses and frames are changed by `edit`.
fn captured(edit: impl FnOnce(&mut Vec<Value>)) -> Files {
    let frame = |i: usize| json!({"file_path": format!("images/{i}.png"), "transform_matrix": pose(i)});
    let mut frames: Vec<Value> = (0..12).map(frame).collect();
    edit(&mut frames);
    let mut files = nerfstudio(|set| set["frames"] = frames.into());
    files.extend((6..12).map(|i| (format!("images/{i}.png"), picture(i))));
    files
}

/// Applies `change` to the camera-to-world matrix of a frame.
fn change_pose(frame: &mut Value, change: impl Fn(DMat4) -> DMat4) {
    let rows: [[f64; 4]; 4] = serde_json::from_value(frame["transform_matrix"].clone()).unwrap();
    let pose = DMat4::from_cols_array_2d(&rows).transpose();
    frame["transform_matrix"] = json!(change(pose).transpose().to_cols_array_2d());
}

fn imported(edit: impl FnOnce(&mut Vec<Value>)) -> Result<Capture, CaptureError> {
    import_folder(&captured(edit))
}

fn warnings(edit: impl FnOnce(&mut Vec<Value>)) -> Vec<String> {
    imported(edit).unwrap().warnings
}

#[test]
fn plausible_poses_give_no_warning() {
    assert_eq!(warnings(|_| ()), [""; 0]);
}

#[test]
fn one_pose_for_all_photographs_is_refused() {
    let error = imported(|frames| {
        let first = frames[0]["transform_matrix"].clone();
        frames.iter_mut().for_each(|frame| frame["transform_matrix"] = first.clone());
    });
    let error = error.unwrap_err().to_string();
    assert_eq!(error, "transforms.json: gives all 12 photographs the same pose");
}

#[test]
fn a_repeated_frame_is_used_once_and_a_second_pose_is_refused() {
    let capture = imported(|frames| frames.push(frames[3].clone())).unwrap();
    assert_eq!(capture.train.len() + capture.test.len(), 12);
    let said = &capture.warnings;
    assert!(
        said.len() == 1 && said[0].ends_with("held out if one of the frames is: images/3.png"),
        "{said:?}"
    );
    let error = imported(|frames| {
        let mut other = frames[3].clone();
        other["transform_matrix"] = frames[4]["transform_matrix"].clone();
        frames.push(other);
    });
    let error = error.unwrap_err();
    assert_eq!(error.field(), Some("frames[12]"));
    assert!(error.to_string().contains("images/3.png, which frames[3] names with another pose"), "{error}");
}

#[test]
fn cameras_that_look_away_are_reported_with_their_number() {
    let outwards = |pose: DMat4| pose * DMat4::from_rotation_y(std::f64::consts::PI);
    let said = warnings(|frames| frames.iter_mut().for_each(|frame| change_pose(frame, outwards)));
    assert!(
        said.len() == 1 && said[0].starts_with("only 0 of 12 cameras look") && said[0].contains("a room"),
        "{said:?}"
    );
}

#[test]
fn poses_with_opencv_axes_are_converted_and_reported() {
    let opencv = |pose: DMat4| DMat4::from_cols(pose.x_axis, -pose.y_axis, -pose.z_axis, pose.w_axis);
    let change = |frames: &mut Vec<Value>| frames.iter_mut().for_each(|frame| change_pose(frame, opencv));
    let capture = imported(change).unwrap();
    let said = &capture.warnings;
    assert!(said.len() == 1 && said[0].contains("OpenCV axes"), "{said:?}");
    let plain = imported(|_| ()).unwrap();
    for (converted, plain) in capture.train.iter().zip(&plain.train) {
        assert_eq!(converted.camera, plain.camera, "{}", plain.name);
    }
}

/// The warnings, and the largest difference of the cameras from those of the ring.
fn converted(change: impl Fn(DMat4) -> DMat4) -> (Vec<String>, f64) {
    let change = |frames: &mut Vec<Value>| frames.iter_mut().for_each(|frame| change_pose(frame, &change));
    let (capture, plain) = (imported(change).unwrap(), imported(|_| ()).unwrap());
    let pairs = capture.train.iter().zip(&plain.train);
    let errors = pairs.map(|(found, right)| {
        let [found, right] = [found, right].map(|view| view.camera.to_opengl().to_cols_array());
        largest_difference(&found, &right)
    });
    (capture.warnings.clone(), worst(errors))
}

#[test]
fn world_to_camera_matrices_are_inverted_and_reported() {
    let opencv = |pose: DMat4| DMat4::from_cols(pose.x_axis, -pose.y_axis, -pose.z_axis, pose.w_axis);
    for (said, error) in [converted(|pose| pose.inverse()), converted(|pose| opencv(pose).inverse())] {
        assert!(said.len() == 1 && said[0].contains("the matrices are inverted"), "{said:?}");
        assert!(said[0].contains("with the matrices inverted all do"), "{said:?}");
        assert!(error < 1e-9, "{error}");
    }
    // Around a point that is not the origin of the world.
    let moved = DMat4::from_translation(DVec3::new(0.7, -0.4, 0.3));
    let said = converted(|pose| (moved * pose).inverse()).0;
    assert!(said.len() == 1 && said[0].contains("the matrices are inverted"), "{said:?}");
    assert!(converted(|pose| pose).0.is_empty(), "the control");
}

/// Whether the poses were inverted, and whether a warning says that they may have to be.
fn readings(poses: &[DMat4], points: &[DVec3]) -> (bool, bool) {
    let rows = |pose: &DMat4| json!(pose.transpose().to_cols_array_2d());
    let mut files = captured(|frames| {
        frames.iter_mut().zip(poses).for_each(|(frame, pose)| frame["transform_matrix"] = rows(pose));
    });
    if !points.is_empty() {
        add_points(&mut files, points);
    }
    let said = import_folder(&files).unwrap().warnings;
    let says = |text: &str| said.iter().any(|warning| warning.contains(text));
    (says("the matrices are inverted"), says("may be world-to-camera instead of camera-to-world: as stated"))
}

#[test]
fn panorama_and_inverted_orbit_are_told_apart_or_reported() {
    let looking =
        |eye: DVec3, target: DVec3| Camera::look_at(eye, target, DVec3::Z, 0.8, (8, 6)).unwrap().to_opengl();
    let towards = |azimuth: f64, elevation: f64| {
        DVec3::new(azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin())
    };
    let jitter = |i: usize| 0.1 * DVec3::new((i % 3) as f64, (i % 2) as f64, (i % 4) as f64);
    let around = |i: usize| looking(3.0 * towards(i as f64, 0.2 + 0.1 * (i % 5) as f64), jitter(i)).inverse();
    assert_eq!(
        readings(&(0..12).map(around).collect::<Vec<_>>(), &[]),
        (true, false),
        "by hand, around an object"
    );
    // Three rows of pictures from one place: inverted, all look at the origin.
    let eye = DVec3::new(0.0, 0.0, -2.0);
    let turned = |i: usize| looking(eye, eye + towards(i as f64, [-0.5, 0.0, 0.5][i % 3]));
    let panorama: Vec<DMat4> = (0..12).map(turned).collect();
    assert_eq!(readings(&panorama, &[]), (false, true), "its cameras are upright as stated");
    let wall = |i: usize| 4.0 * towards(0.2 * i as f64, 0.0) + DVec3::Z * ((i % 5) as f64 - 4.0);
    let walls: Vec<DVec3> = (0..64).map(wall).collect();
    assert!(!readings(&panorama, &walls).0, "its cameras see the points as stated");
    // A short arc around an object: up is common in both readings, so only points decide.
    let near = |i: usize| looking(3.0 * towards(0.08 * i as f64, 0.3), DVec3::ZERO).inverse();
    let arc: Vec<DMat4> = (0..12).map(near).collect();
    assert_eq!(readings(&arc, &[]), (false, true));
    let object: Vec<DVec3> =
        (0..64).map(|i| 0.02 * DVec3::new((i % 4) as f64, (i / 4 % 4) as f64, (i / 16) as f64)).collect();
    assert_eq!(readings(&arc, &object), (true, false));
}

#[test]
fn a_stray_camera_is_named_and_does_not_move_the_bounds() {
    let plain = imported(|_| ()).unwrap();
    let stray = imported(|frames| {
        change_pose(&mut frames[5], |mut pose| {
            pose.w_axis += DVec4::new(4000.0, 100.0, 0.0, 0.0);
            pose
        });
    })
    .unwrap();
    assert!(stray.warnings.iter().any(|w| w.contains("as the others: 1;") && w.ends_with("images/5.png")));
    let moved = (stray.bounds.centre - plain.bounds.centre).length();
    assert!(
        moved < 0.1 && (stray.bounds.radius / plain.bounds.radius - 1.0).abs() < 0.1,
        "{:?}",
        stray.bounds
    );
}

#[test]
fn a_world_whose_up_is_no_axis_is_reported() {
    let oblique = DMat4::from_rotation_x(-1.5) * DMat4::from_rotation_y(0.8);
    let said =
        warnings(|frames| frames.iter_mut().for_each(|frame| change_pose(frame, |pose| oblique * pose)));
    assert!(said.len() == 1 && said[0].contains("not +Z") && said[0].contains("--up"), "{said:?}");
    let turned = DMat4::from_rotation_translation(glam::DQuat::from_rotation_z(1.0), DVec3::splat(5.0));
    let same =
        warnings(|frames| frames.iter_mut().for_each(|frame| change_pose(frame, |pose| turned * pose)));
    assert_eq!(same, [""; 0], "the control: rotated about +Z and moved");
}

#[test]
fn cameras_that_are_upside_down_are_named() {
    let roll = DMat4::from_rotation_z(std::f64::consts::PI);
    let said = warnings(|frames| change_pose(&mut frames[4], |pose| pose * roll));
    assert!(
        said.len() == 1 && said[0].contains("upside down") && said[0].ends_with("images/4.png"),
        "{said:?}"
    );
}

#[test]
fn photographs_with_equal_pixels_are_named() {
    let mut files = captured(|_| ());
    files.insert("images/5.png".to_owned(), picture(3));
    let said = import_folder(&files).unwrap().warnings;
    assert_eq!(said, ["photographs that equal another one: 1: images/5.png (as images/3.png)"]);
    // The first photograph is held out.
    files.insert("images/7.png".to_owned(), picture(0));
    let said = import_folder(&files).unwrap().warnings;
    assert!(said.len() == 1 && said[0].contains("held out at once"), "{said:?}");
}

/// Adds a point cloud to a nerfstudio set.
fn add_points(files: &mut Files, points: &[DVec3]) {
    let mut set: Value = serde_json::from_slice(&files["transforms.json"]).unwrap();
    set["ply_file_path"] = json!("points.ply");
    files.insert("transforms.json".to_owned(), set.to_string().into_bytes());
    let rows: String = points.iter().map(|p| format!("{} {} {}\n", p.x, p.y, p.z)).collect();
    let header = format!("ply\nformat ascii 1.0\nelement vertex {}\n", points.len());
    let axes = "property float x\nproperty float y\nproperty float z\n";
    files.insert("points.ply".to_owned(), format!("{header}{axes}end_header\n{rows}").into_bytes());
}

#[test]
fn points_that_no_camera_sees_are_reported() {
    let with_points = |offset: f64| {
        let mut files = captured(|_| ());
        let point = |i: usize| DVec3::new((i % 4) as f64, (i / 4) as f64, offset);
        add_points(&mut files, &(0..16).map(point).collect::<Vec<_>>());
        import_folder(&files).unwrap().warnings
    };
    let said = with_points(50.0);
    assert!(said.len() == 1 && said[0].contains("only 0 of 12 cameras see the point cloud"), "{said:?}");
    assert_eq!(with_points(0.0), [""; 0], "the control");
}
