//! Small valid files of every kind that a user may send.

use std::io::Cursor;

use image::ImageEncoder;
use relume_capture::formats::{environment, exr_image, image_file, model_file, ply_model};
use relume_scene::EnvMap;
use serde_json::json;

use relume_fixtures::model;
use relume_fixtures::small_set::{Files, blender, camera, colmap, nerfstudio, picture, polycam};

pub fn images() -> Vec<Vec<u8>> {
    let rgb: Vec<[u8; 3]> = (0..48).map(|p| [p, 200, 255 - p]).collect();
    let wide: Vec<[u16; 3]> = (0..48).map(|p| [p * 1000, 20_000, 65_535 - p]).collect();
    let mut webp = Vec::new();
    let encoder = image::codecs::webp::WebPEncoder::new_lossless(Cursor::new(&mut webp));
    encoder.write_image(rgb.as_flattened(), 8, 6, image::ExtendedColorType::Rgb8).unwrap();
    vec![
        picture(1),
        image_file::encode_png16(8, 6, &wide).unwrap(),
        image_file::encode_jpeg(8, 6, &rgb, 90).unwrap(),
        webp,
    ]
}

pub fn environments() -> Vec<Vec<u8>> {
    let texels: Vec<[f32; 3]> = (0..32).map(|i| [i as f32, 0.5, 100.0 - i as f32]).collect();
    let (map, _) = EnvMap::new(8, 4, texels.clone()).unwrap();
    let mut plain = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=1.0\n\n-Y 4 +X 8\n".to_vec();
    plain.extend([128, 128, 128, 129].repeat(32));
    let mut columns =
        b"#?RGBE\r\nEXPOSURE=2\r\nCOLORCORR=1 2 1\r\nPRIMARIES=.7 .3 .2 .8 .1 .1 .3 .3\r\n\r\n+X 8 -Y 4\r\n"
            .to_vec();
    columns.extend([128, 128, 128, 129].repeat(32));
    vec![
        environment::encode_hdr(&map).unwrap(),
        environment::encode_exr(&map).unwrap(),
        exr_image::encode_rgb(8, 4, &texels).unwrap(),
        plain,
        columns,
    ]
}

pub fn models() -> Vec<Vec<u8>> {
    (1..4).map(|count| model_file::encode(&model::model(count, 7)).unwrap()).collect()
}

pub fn clouds() -> Vec<Vec<u8>> {
    let text = "ply\nformat ascii 1.0\ncomment a cloud\nelement vertex 2\nproperty float x\nproperty float y\nproperty double z\n\
                property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n0 0 1 255 0 0\n1 2 3 0 255 0\n";
    let mut binary = text
        .replace("ascii", "binary_little_endian")
        .split("end_header\n")
        .next()
        .unwrap()
        .as_bytes()
        .to_vec();
    binary.extend(b"end_header\n");
    binary.extend([1u8; 38]);
    vec![text.as_bytes().to_vec(), binary, ply_model::encode(&model::model(2, 7))]
}

/// Splats as PLY, `.splat`, SPZ of version 3 and compressed PLY.
pub fn splats() -> Vec<Vec<u8>> {
    let mut record: Vec<u8> =
        [1.0f32, 2.0, 3.0, 0.1, 0.2, 0.3].iter().flat_map(|v| v.to_le_bytes()).collect();
    record.extend([255, 128, 0, 200, 255, 128, 128, 128]);
    let mut spz = b"NGSP\x03\0\0\0\x02\0\0\0\x01\x0c\0\0".to_vec();
    spz.extend((0..2 * (9 + 1 + 3 + 3 + 4 + 9)).map(|i| (i * 37) as u8));
    let mut compressed = String::from("ply\nformat binary_little_endian 1.0\nelement chunk 1\n");
    for name in ["x", "y", "z", "scale_x", "scale_y", "scale_z"] {
        compressed += &format!("property float min_{name}\nproperty float max_{name}\n");
    }
    compressed += "element vertex 2\nproperty uint packed_position\nproperty uint packed_rotation\n";
    compressed += "property uint packed_scale\nproperty uint packed_color\nend_header\n";
    let mut compressed = compressed.into_bytes();
    (0..6).flat_map(|_| [-1.0f32, 1.0]).for_each(|v| compressed.extend(v.to_le_bytes()));
    compressed.extend((0..32).map(|i| (i * 53) as u8));
    vec![ply_model::encode(&model::model(2, 7)), record.repeat(3), spz, compressed]
}

/// Captures in every layout, as files, because some archive formats have checksums that changed files would
/// not match.
pub fn captures() -> Vec<Files> {
    let mut hidden = blender();
    hidden.insert("light_rotations.json".to_owned(), b"{\"train/r_0\": 10.0}".to_vec());
    let distorted = nerfstudio(|set| {
        (set["k1"], set["k2"], set["p1"]) = (json!(0.1), json!(-0.01), json!(0.001));
        set["frames"][1]["mask_path"] = json!("images/0.png");
    });
    let matrices = nerfstudio(|set| {
        set["camera_model"] = json!("THIN_PRISM_FISHEYE");
        set["frames"][0]["K"] = json!([[9.0, 0, 4.0], [0, 9.5, 3.0], [0, 0, 1]]);
        set["frames"][1]["file_path"] = json!("C:\\scan\\images\\1.PNG");
    });
    let mut fisheye = colmap();
    fisheye.insert("sparse/0/cameras.txt".to_owned(), b"1 FOV 8 6 9 9.5 4 3 0.8\n".to_vec());
    vec![
        blender(),
        hidden,
        distorted,
        nerfstudio(|_| {}),
        matrices,
        colmap(),
        fisheye,
        binary_colmap(),
        polycam(),
    ]
}

/// The COLMAP model of [`colmap`], as binary files.
fn binary_colmap() -> Files {
    let mut files = colmap();
    files.retain(|name, _| !name.ends_with(".txt"));
    let numbers = |numbers: &[f64]| -> Vec<u8> { numbers.iter().flat_map(|n| n.to_le_bytes()).collect() };
    let mut cameras =
        [1u64.to_le_bytes().to_vec(), 1u32.to_le_bytes().to_vec(), 1u32.to_le_bytes().to_vec()].concat();
    cameras.extend([8u64, 6].iter().flat_map(|n| n.to_le_bytes()));
    cameras.extend(numbers(&[9.0, 9.5, 4.0, 3.0]));
    let mut images = 4u64.to_le_bytes().to_vec();
    for i in 0..4u32 {
        let camera = camera(i as usize);
        let (q, t) = (glam::DQuat::from_mat3(&camera.rotation), camera.translation);
        images.extend((i + 1).to_le_bytes());
        images.extend(numbers(&[q.w, q.x, q.y, q.z, t.x, t.y, t.z]));
        images.extend(1u32.to_le_bytes());
        images.extend(format!("{i}.png\0").bytes());
        images.extend(1u64.to_le_bytes());
        images.extend([numbers(&[2.0, 3.0]), 1u64.to_le_bytes().to_vec()].concat());
    }
    let mut points = 1u64.to_le_bytes().to_vec();
    points.extend(1u64.to_le_bytes());
    points.extend(numbers(&[0.0, 0.1, 0.2]));
    points.extend([255, 0, 0]);
    points.extend(numbers(&[0.1]));
    points.extend(1u64.to_le_bytes());
    points.extend([1u32.to_le_bytes(), 0u32.to_le_bytes()].concat());
    for (name, bytes) in [("cameras", cameras), ("images", images), ("points3D", points)] {
        files.insert(format!("sparse/0/{name}.bin"), bytes);
    }
    files
}

pub fn bodies() -> Vec<Vec<u8>> {
    let job = json!({
        "capture": "c", "preset": "draft", "priority": 1, "name": "n", "labels": { "a": "b" },
        "overrides": { "iterations": 10, "resolution": 32, "seed": 1,
            "light": { "environment": "studio", "rotation_deg": 0.0, "exposure_ev": 0.0 } },
        "quality_gate": { "novel_view.psnr": ">=28" },
    });
    let look_at = json!({ "eye": [3, 0, 1], "target": [0, 0, 0], "up": [0, 0, 1], "fov_y_deg": 40 });
    let render = json!({
        "camera": { "look_at": look_at }, "width": 16, "height": 16, "tier": "standard", "samples": 4,
        "environment": { "name": "studio", "rotation_deg": 10.0, "exposure_ev": 0.5 }, "outputs": ["rgb", "normal"],
        "background": "#f4f4f4",
    });
    let change =
        json!({ "name": null, "external_id": "e", "labels": { "a": null, "b": "c" }, "priority": 3 });
    let key = json!({ "name": "k", "tenant": "t", "scopes": ["read", "admin"], "expires_in": 60 });
    let webhook = json!({ "url": "https://relume.example/hook", "events": ["job.failed"], "name": "w" });
    let source =
        json!({ "url": "https://relume.example/a.zip", "sha256": "00", "name": "n", "labels": { "a": "b" } });
    [job, render, change, key, webhook, source].map(|body| body.to_string().into_bytes()).to_vec()
}
