//! Tests of the text and binary readers on one model and on damaged files, and of the orientation of the world.

use glam::{DQuat, DVec3};

use super::binary::{self, ByteReader};
use super::model::{PosedImage, SparseModel};
use super::pose;
use super::text::{self, TextFile};
use crate::CaptureError;
use crate::Up;
use crate::upright::{StatedUp, upright};
use relume_scene::Camera;

const CAMERAS: &str =
    "# comment\n1 OPENCV 640 480 500 510 320 240 0.1 -0.05 0.001 0.002\n2 PINHOLE 64 48 50 51 32 24\n";
const IMAGES: &str = "# two lines each\n1 1 0 0 0 0.5 0.25 2 1 a b.jpg\n1.0 2.0 -1 3.0 4.0 7\n\
    2 0.5 0.5 0.5 0.5 1 2 3 2 c.jpg\n\n";
const POINTS: &str = "7 1 2 3 255 0 0 0.5 1 0 2 0\n8 -1 0 1 0 255 0 0.1\n";

/// The text model above, as COLMAP writes it in binary.
fn binary() -> [Vec<u8>; 3] {
    fn put(out: &mut Vec<u8>, values: &[f64]) {
        values.iter().for_each(|v| out.extend(v.to_le_bytes()));
    }
    let mut cameras = 2u64.to_le_bytes().to_vec();
    for (id, model, w, h, p) in [
        (1u32, 4u32, 640u64, 480u64, &[500., 510., 320., 240., 0.1, -0.05, 0.001, 0.002][..]),
        (2, 1, 64, 48, &[50., 51., 32., 24.]),
    ] {
        cameras.extend([id, model].map(u32::to_le_bytes).as_flattened());
        cameras.extend([w, h].map(u64::to_le_bytes).as_flattened());
        put(&mut cameras, p);
    }
    let mut images = 2u64.to_le_bytes().to_vec();
    for (id, pose, camera, name, observations) in [
        (1u32, [1., 0., 0., 0., 0.5, 0.25, 2.], 1u32, "a b.jpg", 2u64),
        (2, [0.5, 0.5, 0.5, 0.5, 1., 2., 3.], 2, "c.jpg", 0),
    ] {
        images.extend(id.to_le_bytes());
        put(&mut images, &pose);
        images.extend(camera.to_le_bytes());
        images.extend(name.bytes().chain([0]));
        images.extend(observations.to_le_bytes());
        images.extend(vec![7; 24 * observations as usize]);
    }
    let mut points = 2u64.to_le_bytes().to_vec();
    for (id, xyz, rgb, track) in
        [(7u64, [1., 2., 3.], [255u8, 0, 0], 2u64), (8, [-1., 0., 1.], [0, 255, 0], 0)]
    {
        points.extend(id.to_le_bytes());
        put(&mut points, &xyz);
        points.extend(rgb);
        put(&mut points, &[0.5]);
        points.extend(track.to_le_bytes());
        points.extend(vec![1; 8 * track as usize]);
    }
    [cameras, images, points]
}

fn read_binary([cameras, images, points]: &[Vec<u8>; 3]) -> Result<SparseModel, CaptureError> {
    Ok(SparseModel {
        lenses: binary::cameras(ByteReader::new("cameras.bin", cameras))?,
        images: binary::images(ByteReader::new("images.bin", images), 100)?,
        points: binary::points(ByteReader::new("points3D.bin", points), 100)?,
    })
}

fn file<'a>(file: &'a str, text: &'a str) -> TextFile<'a> {
    TextFile::new(file, text.as_bytes()).unwrap()
}

#[test]
fn text_and_binary_models_parse_equally() {
    let binary = read_binary(&binary()).unwrap();
    assert_eq!(text::cameras(&file("cameras.txt", CAMERAS)).unwrap(), binary.lenses);
    let images = text::images(&file("images.txt", IMAGES), 10).unwrap();
    assert_eq!(format!("{images:?}"), format!("{:?}", binary.images));
    assert_eq!(images[0].name, "a b.jpg");
    assert_eq!(text::points(&file("points3D.txt", POINTS), 10).unwrap(), binary.points);
}

#[test]
fn wrong_counts_in_headers_are_refused_without_allocation() {
    for file in 0..3 {
        for count in [3u64, 1 << 20, u64::MAX] {
            let mut files = binary();
            files[file][..8].copy_from_slice(&count.to_le_bytes());
            let error = read_binary(&files).unwrap_err();
            assert_eq!(error.code(), "capture_file_invalid", "{error}");
        }
    }
}

#[test]
fn truncated_models_are_refused_and_flipped_bytes_never_panic() {
    for file in 0..3 {
        let whole = binary();
        for at in 0..whole[file].len() {
            let mut cut = whole.clone();
            cut[file].truncate(at);
            assert!(read_binary(&cut).is_err(), "file {file} cut at {at}");
            for flip in [0x01, 0x80, 0xff] {
                let mut flipped = whole.clone();
                flipped[file][at] ^= flip;
                let _ = read_binary(&flipped);
            }
        }
    }
}

#[test]
fn invalid_values_are_refused_by_field() {
    let field = |e: CaptureError| e.field().unwrap().to_owned();
    let cameras =
        |from, to| text::cameras(&file("c", &CAMERAS.replace(from, to))).map_err(field).unwrap_err();
    assert_eq!(cameras("OPENCV", "FULL_OPENCV"), "cameras[1].params");
    assert_eq!(cameras("-0.05", "nan"), "cameras[1].params");
    assert_eq!(cameras("640 480", "640"), "cameras[1].params");
    let images =
        |from, to| text::images(&file("i", &IMAGES.replace(from, to)), 9).map_err(field).unwrap_err();
    assert_eq!(images("1 1 0 0 0 ", "1 0 0 0 0 "), "images[a b.jpg].qvec");
    assert_eq!(images("0.25", "inf"), "images[a b.jpg].tvec");
    assert_eq!(images("2 1 a b.jpg", "x"), "line 2");
    let points =
        |from, to| text::points(&file("p", &POINTS.replace(from, to)), 9).map_err(field).unwrap_err();
    assert_eq!(points("-1 0 1", "-1 NaN 1"), "points3D[1].xyz");
}

#[test]
fn points_project_as_in_colmap_and_camera_up_becomes_z() {
    let rotation = DQuat::from_euler(glam::EulerRot::XYZ, 1.4, 0.2, -0.3);
    let image =
        PosedImage { name: "a.jpg".into(), camera: 1, rotation, translation: DVec3::new(0.3, -0.2, 2.0) };
    let poses = [pose(&image, DQuat::IDENTITY)];
    let turn = upright(&poses, &[], Up::AUTO, StatedUp::No("COLMAP"), &mut Vec::new()).rotation();
    let camera = Camera::from_opengl(&pose(&image, turn), (100, 80), (90.0, 95.0), (50.0, 40.0)).unwrap();
    let world = DVec3::new(0.2, 0.1, 0.4);
    let expected = rotation * world + image.translation;
    let got = camera.rotation * (turn * world) + camera.translation;
    assert!((got - expected).length() < 1e-12, "{got} {expected}");
    assert!((-camera.rotation.row(1) - DVec3::Z).length() < 1e-9, "this camera's up is the world's");
    assert!((got - (rotation * (turn * world) + image.translation)).length() > 0.1, "the rotation matters");
}

#[test]
fn cameras_without_common_up_give_no_rotation_and_a_warning() {
    let image = |rotation| PosedImage { name: "a".into(), camera: 1, rotation, translation: DVec3::ZERO };
    let mut warnings = Vec::new();
    let poses = [0.0, 3.1].map(|angle| pose(&image(DQuat::from_rotation_z(angle)), DQuat::IDENTITY));
    let turn = upright(&poses, &[], Up::AUTO, StatedUp::No("COLMAP"), &mut warnings).rotation();
    assert_eq!((turn, warnings.len()), (DQuat::IDENTITY, 1));
}
