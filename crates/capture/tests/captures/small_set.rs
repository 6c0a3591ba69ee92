//! A small valid capture as files in memory, for tests to pack and to damage.

use std::collections::BTreeMap;
use std::io::{Cursor, Write};

use glam::DVec3;
use relume_capture::{Capture, CaptureError, ImportOptions, import};
use relume_capture::formats::image_file;
use relume_compare::largest_difference;
use relume_scene::Camera;
use serde_json::{Value, json};

/// Files by path.
pub type Files = BTreeMap<String, Vec<u8>>;

/// The pose of camera `i` on a ring around the origin, as rows of a camera-to-world matrix in OpenGL axes.
pub fn pose(i: usize) -> [[f64; 4]; 4] {
    camera(i).to_opengl().transpose().to_cols_array_2d()
}

/// Camera `i` of the ring: 8x6 pixels.
pub fn camera(i: usize) -> Camera {
    let angle = i as f64;
    let eye = DVec3::new(3.0 * angle.cos(), 3.0 * angle.sin(), 1.0);
    Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.8, (8, 6)).unwrap()
}

/// An 8x6 RGBA image whose colour tells `i`; the left column is transparent.
pub fn picture(i: usize) -> Vec<u8> {
    let pixel = |p: u8| [i as u8 * 10, p, 200, if p.is_multiple_of(8) { 0 } else { 255 }];
    image_file::encode_png(8, 6, &(0..48).map(pixel).collect::<Vec<_>>()).unwrap()
}

/// The JSON of a NeRF-synthetic set with `count` frames.
pub fn transforms(count: usize) -> Value {
    let frame = |i: usize| json!({"file_path": format!("./train/r_{i}"), "transform_matrix": pose(i)});
    json!({"camera_angle_x": 0.8, "frames": (0..count).map(frame).collect::<Vec<_>>()})
}

/// A NeRF-synthetic set of four images.
pub fn blender() -> Files {
    let mut files: Files = (0..4).map(|i| (format!("train/r_{i}.png"), picture(i))).collect();
    files.insert("transforms_train.json".into(), transforms(4).to_string().into_bytes());
    files
}

/// The files of a nerfstudio set with six images and the JSON changed by `edit`.
pub fn nerfstudio(edit: impl FnOnce(&mut Value)) -> Files {
    let frame = |i: usize| json!({"file_path": format!("images/{i}.png"), "transform_matrix": pose(i)});
    let mut set = json!({
        "camera_model": "OPENCV", "fl_x": 9.0, "fl_y": 9.5, "cx": 4.0, "cy": 3.0, "w": 8, "h": 6,
        "frames": (0..6).map(frame).collect::<Vec<_>>(),
    });
    edit(&mut set);
    let mut files: Files = (0..6).map(|i| (format!("images/{i}.png"), picture(i))).collect();
    files.insert("transforms.json".into(), set.to_string().into_bytes());
    files
}

/// A COLMAP text model of four images.
pub fn colmap() -> Files {
    let mut files: Files = (0..4).map(|i| (format!("images/{i}.png"), picture(i))).collect();
    let mut images = String::from("# Image list\n");
    for i in 0..4 {
        let c = camera(i);
        let q = glam::DQuat::from_mat3(&c.rotation);
        let t = c.translation;
        images += &format!("{} {} {} {} {} {} {} {} 1 {i}.png\n\n", i + 1, q.w, q.x, q.y, q.z, t.x, t.y, t.z);
    }
    files.insert("sparse/0/cameras.txt".into(), b"1 PINHOLE 8 6 9 9.5 4 3\n".to_vec());
    files.insert("sparse/0/images.txt".into(), images.into_bytes());
    files
        .insert("sparse/0/points3D.txt".into(), b"1 0 0 0 255 0 0 0.1 1 0\n2 0.5 0 0 0 255 0 0.1\n".to_vec());
    files
}

/// Packs files into a zip.
pub fn zip(files: &Files) -> Vec<u8> {
    let mut writer = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in files {
        writer.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        writer.write_all(bytes).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

/// Packs files into a tar.
pub fn tar(files: &Files) -> Vec<u8> {
    let mut builder = tar::Builder::new(Vec::new());
    for (name, bytes) in files {
        let mut header = tar::Header::new_gnu();
        header.set_size(bytes.len() as u64);
        header.set_mode(0o644);
        builder.append_data(&mut header, name, &bytes[..]).unwrap();
    }
    builder.into_inner().unwrap()
}

/// Gzips bytes.
pub fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// Imports an archive given as bytes.
pub fn import_bytes(bytes: &[u8]) -> Result<Capture, CaptureError> {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    import(file.path(), &ImportOptions::default())
}

/// Imports files from a folder on disk.
pub fn import_folder(files: &Files) -> Result<Capture, CaptureError> {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in files {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
    import(folder.path(), &ImportOptions::default())
}

/// A pose with one entry replaced.
pub fn pose_with_entry(row: usize, column: usize, value: Value) -> Value {
    let mut pose = json!(pose(0));
    pose[row][column] = value;
    pose
}

/// The largest difference between a camera and camera `i` of the ring.
pub fn pose_error(camera: &Camera, i: usize) -> f64 {
    let [found, expected] = [camera, &self::camera(i)].map(|c| c.to_opengl().to_cols_array());
    largest_difference(&found, &expected)
}
