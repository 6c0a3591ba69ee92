//! `relume render --light-matrix` and `relume weights` on the command line.

use std::fs;
use std::path::Path;

use exr::prelude::{ReadChannels as _, ReadLayers as _};
use relume_capture::formats::environment;
use relume_compare::rms_difference;
use relume_scene::EnvMap;
use relume_scene::light::LightLobes;
use serde_json::{Value, json};

use crate::render_sequence::{fails_with, names, succeeds, with_model};

const RENDER: [&str; 4] = ["render", "m.safetensors", "--azimuth", "30"];
const LOBES: usize = 32;

/// Name and interleaved RGB of each part with three colours of its own.
pub fn parts(bytes: &[u8]) -> Vec<(String, Vec<f32>)> {
    let reader = exr::prelude::read().no_deep_data().largest_resolution_level();
    let reader = reader.all_channels().all_layers().all_attributes();
    let image = reader.from_buffered(std::io::Cursor::new(bytes)).unwrap();
    let colours = |layer: &exr::image::Layer<exr::image::AnyChannels<exr::image::FlatSamples>>| {
        let plane = |suffix: &str| -> Option<Vec<f32>> {
            let is_wanted = |name: &str| name == suffix || name.ends_with(&format!(".{suffix}"));
            let channel =
                layer.channel_data.list.iter().find(|channel| is_wanted(&channel.name.to_string()))?;
            Some(channel.sample_data.values_as_f32().collect())
        };
        let [red, green, blue] = [plane("R")?, plane("G")?, plane("B")?];
        let pixels = red.iter().zip(&green).zip(&blue).flat_map(|((r, g), b)| [*r, *g, *b]).collect();
        Some((layer.attributes.layer_name.as_ref()?.to_string(), pixels))
    };
    image.layer_data.iter().filter_map(colours).collect()
}

/// The weighted sum of the parts of a matrix, with the weights of a JSON file of `relume weights` in the order `order`.
fn weighted_sum(matrix: &[(String, Vec<f32>)], weights: &Value, order: impl Fn(usize) -> usize) -> Vec<f32> {
    let weights = weights["parts"].as_array().unwrap();
    assert_eq!(weights.len(), matrix.len());
    let mut sum = vec![0.0f32; matrix[0].1.len()];
    for (k, (name, frame)) in matrix.iter().enumerate() {
        assert_eq!(weights[k]["part"], json!(name));
        let rgb: [f32; 3] = serde_json::from_value(weights[order(k)]["rgb"].clone()).unwrap();
        for (i, (sum, value)) in sum.iter_mut().zip(frame).enumerate() {
            *sum += rgb[i % 3] * value;
        }
    }
    sum
}

/// Root mean square difference over that of `expected` from 0.
fn relative(found: &[f32], expected: &[f32]) -> f64 {
    rms_difference(found, expected) / rms_difference(expected, &vec![0.0; expected.len()])
}

/// Writes `sky.hdr`, a map that is even in each lobe.
fn write_sky(folder: &Path) {
    let lobes = LightLobes::new(LOBES);
    let of = |d: &glam::DVec3| [1.2 + d.z, 1.0 + 0.5 * d.x, 0.8 + 0.6 * d.y * d.z].map(|v| v as f32);
    let weights: Vec<[f32; 3]> = lobes.directions().iter().map(of).collect();
    fs::write(folder.join("sky.hdr"), environment::encode_hdr(&lobes.combined(&weights)).unwrap()).unwrap();
}

/// A map with a small sun.
pub fn sunny() -> Vec<u8> {
    let sun = glam::DVec3::new(0.6, 0.0, 0.8);
    let texel = |d: glam::DVec3| if d.dot(sun) > 0.999 { [4000.0; 3] } else { [0.5; 3] };
    environment::encode_hdr(&EnvMap::from_fn(128, 64, texel)).unwrap()
}

#[test]
fn weighted_sum_of_a_matrix_file_is_the_rendered_frame() {
    let folder = with_model();
    let at = folder.path();
    write_sky(at);
    let frame = ["--device", "cpu", "--size", "40", "--env", "sky.hdr", "--out", "frame.exr"];
    succeeds(at, &[&RENDER[..], &frame].concat());
    let frame = parts(&fs::read(at.join("frame.exr")).unwrap()).remove(0).1;
    for depth in ["half", "float"] {
        let matrix = ["--size", "40", "--light-matrix", "32", "--colour-depth", depth, "--out", "matrix.exr"];
        succeeds(at, &[&RENDER[..], &matrix].concat());
        succeeds(at, &["weights", "sky.hdr", "--like", "matrix.exr", "--out", "weights.json"]);
        let matrix = parts(&fs::read(at.join("matrix.exr")).unwrap());
        let weights: Value = serde_json::from_slice(&fs::read(at.join("weights.json")).unwrap()).unwrap();
        let error = relative(&weighted_sum(&matrix, &weights, |k| k), &frame);
        assert!(error < 1e-3, "{depth}: {error}");
        let wrong = relative(&weighted_sum(&matrix, &weights, |k| LOBES - 1 - k), &frame);
        assert!(wrong > 0.03, "the control: the weights of other lobes, {wrong}");
    }
}

#[test]
fn matrices_of_a_sequence_are_those_of_single_cameras() {
    let folder = with_model();
    let at = folder.path();
    let matrix =
        ["render", "m.safetensors", "--size", "24", "--light-matrix", "8", "--env", "sun.hdr", "--azimuth"];
    fs::write(at.join("sun.hdr"), sunny()).unwrap();
    let said = succeeds(at, &[&matrix[..], &["30", "--out", "one.exr"]].concat());
    assert!(said.contains("lobes: 8, strong small lights: 1"), "{said}");
    let one = fs::read(at.join("one.exr")).unwrap();
    let found: Vec<String> = parts(&one).into_iter().map(|(name, _)| name).collect();
    assert_eq!(found.len(), 9);
    assert!(found[0].starts_with("lobe001_") && found[8].starts_with("sun001_"), "{found:?}");
    let turntable = [&matrix[..], &["30", "--turntable", "2", "--out", "t/%03d.exr"]].concat();
    succeeds(at, &turntable);
    assert_eq!(names(&at.join("t")), ["001.exr", "002.exr"], "and nothing else");
    assert!(fs::read(at.join("t/001.exr")).unwrap() == one);
    assert!(fs::read(at.join("t/002.exr")).unwrap() != one, "the control");
    fs::write(at.join("t/001.exr"), "made earlier").unwrap();
    fs::remove_file(at.join("t/002.exr")).unwrap();
    let said = succeeds(at, &[&turntable[..], &["--resume"]].concat());
    assert!(said.contains("frames written: 1, existed already: 1"), "{said}");
}

#[test]
fn options_that_a_matrix_does_not_have_are_refused() {
    let folder = with_model();
    let at = folder.path();
    let look = json!({ "look_at": { "eye": [3, 0, 0], "target": [0, 0, 0], "fov_y_deg": 40 } });
    let turned =
        json!({ "width": 8, "height": 8, "cameras": [{ "camera": look, "light_rotation_deg": 90 }] });
    fs::write(at.join("turned.json"), turned.to_string()).unwrap();
    let matrix = ["render", "m.safetensors", "--size", "8", "--light-matrix", "4"];
    let cases: [(&[&str], &str); 15] = [
        (&["--out", "m.png"], "m.png: a light matrix must end in .exr"),
        (&["--out", "m.exr", "--tier", "high"], "--tier: "),
        (&["--out", "m.exr", "--output", "albedo"], "--output: "),
        (&["--out", "m.exr", "--background", "ffffff"], "--background: "),
        (&["--out", "m.exr", "--tone-curve", "agx"], "--tone-curve: "),
        (&["--out", "m.exr", "--alpha", "straight"], "--alpha: "),
        (&["--out", "m.exr", "--primaries", "acescg"], "--primaries: "),
        (&["--out", "m.exr", "--exposure", "1"], "--exposure: "),
        (&["--out", "m.exr", "--rotation", "10"], "--rotation: "),
        (&["--out", "m%d.exr", "--turntable", "2", "--env-turn", "360"], "--env-turn: "),
        (&["--out", "m.exr", "--device", "gpu"], "--device: "),
        (&["--out", "m.exr", "--env", "moon.hdr"], "moon.hdr"),
        (&["--out", "m.exr", "--turntable", "2"], "m.exr: "),
        (&["--out", "m%d.exr", "--path", "turned.json", "--env", "studio"], "--path: camera 1 turns"),
        (&["--out", "turned.json/m.exr"], "turned.json/m.exr: "),
    ];
    for (more, reason) in cases {
        fails_with(at, &[&matrix[..], more].concat(), reason);
    }
    for lobes in ["0", "513", "many"] {
        let wrong = ["render", "m.safetensors", "--light-matrix", lobes, "--out", "m.exr"];
        fails_with(at, &wrong, "--light-matrix <LOBES>");
    }
    assert_eq!(names(at), ["m.safetensors", "scan.zip", "turned.json"], "nothing was written");
    succeeds(at, &[&matrix[..], &["--out", "m%d.exr", "--path", "turned.json"]].concat());
    assert!(at.join("m1.exr").exists(), "the control: without --env a turned light is a matter of weights");
}

#[test]
fn weights_are_written_for_compositors_and_wrong_files_refused() {
    let folder = with_model();
    let at = folder.path();
    succeeds(at, &["render", "m.safetensors", "--size", "16", "--light-matrix", "6", "--out", "matrix.exr"]);
    succeeds(
        at,
        &["render", "m.safetensors", "--size", "16", "--env", "studio", "--device", "cpu", "--out", "f.exr"],
    );
    let weights = |more: &[&str]| {
        let arguments = ["weights", "studio", "--like", "matrix.exr", "--out", "w.txt"];
        succeeds(at, &[&arguments[..], more].concat());
        fs::read_to_string(at.join("w.txt")).unwrap()
    };
    let plain: Value = serde_json::from_str(&weights(&[])).unwrap();
    let brighter: Value = serde_json::from_str(&weights(&["--exposure", "1"])).unwrap();
    let first = |weights: &Value| weights["parts"][0]["rgb"][0].as_f64().unwrap();
    assert!((first(&brighter) / first(&plain) - 2.0).abs() < 1e-5, "{brighter}");
    let turned: Value = serde_json::from_str(&weights(&["--rotation", "180"])).unwrap();
    assert_ne!(turned["parts"], plain["parts"], "the control");
    let recovered = ["weights", "recovered", "--like", "matrix.exr", "--model", "m.safetensors"];
    succeeds(at, &recovered);
    let nuke = weights(&["--format", "nuke"]);
    assert_eq!((nuke.matches("Multiply {").count(), nuke.matches("Merge2 {").count()), (6, 5));
    let fusion = weights(&["--format", "fusion"]);
    assert_eq!((fusion.matches("= Loader {").count(), fusion.matches("= Custom {").count()), (7, 6));

    fs::write(at.join("cut.exr"), &fs::read(at.join("matrix.exr")).unwrap()[..500]).unwrap();
    for (env, like, reason) in [
        ("studio", "none.exr", "none.exr: No such file"),
        ("studio", "f.exr", "f.exr: is not a light matrix"),
        ("studio", "m.safetensors", "m.safetensors: cannot be decoded"),
        ("studio", "cut.exr", "cut.exr: cannot be decoded"),
        ("moon.hdr", "matrix.exr", "moon.hdr: "),
        ("recovered", "matrix.exr", "name the model with --model"),
    ] {
        fails_with(at, &["weights", env, "--like", like], reason);
    }
}
