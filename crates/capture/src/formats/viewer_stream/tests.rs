use glam::DVec3;
use half::f16;
use relume_compare::largest_difference;
use serde_json::Value;

use super::*;
use relume_scene::{EnvMap, Field, Framing, Gaussians, MAX_LIGHTS, Model, SplitLight};

/// A decoded stream.
struct Read {
    header: Value,
    arrays: Vec<Vec<f32>>,
    /// All rows of each field, by name.
    records: Vec<(String, Vec<f32>)>,
}

fn value(entry: &Value, k: usize, bytes: &mut &[u8]) -> f32 {
    let bound = |name: &str| entry[name][k].as_f64().unwrap() as f32;
    let between = |share: f32| bound("low") + (bound("high") - bound("low")) * share;
    let mut take = |n: usize| bytes.split_off(..n).unwrap();
    match entry["type"].as_str().unwrap() {
        "f32" => f32::from_le_bytes(take(4).try_into().unwrap()),
        "f16" => {
            f16::from_le_bytes(take(2).try_into().unwrap()).to_f32() * entry["scale"].as_f64().unwrap() as f32
        }
        "u16" => between(f32::from(u16::from_le_bytes(take(2).try_into().unwrap())) / 65535.0),
        "u8" => between(f32::from(take(1)[0]) / 255.0),
        other => panic!("{other}"),
    }
}

fn read(mut bytes: &[u8], magic: &[u8; 4]) -> Read {
    let all = bytes.len();
    let mut take = |n: usize| bytes.split_off(..n).unwrap();
    assert_eq!(take(4), magic);
    assert_eq!(take(4), VERSION.to_le_bytes());
    let length = u32::from_le_bytes(take(4).try_into().unwrap()) as usize;
    let header: Value = serde_json::from_slice(take(length)).unwrap();
    let number = |v: &Value| v.as_u64().unwrap() as usize;
    let arrays = header["arrays"].as_array().unwrap().iter().map(|entry| {
        let n = number(&entry["components"]) * number(&entry["count"]);
        let out = (0..n).map(|i| value(entry, i % number(&entry["components"]), &mut bytes)).collect();
        bytes = &bytes[(4 - (all - bytes.len()) % 4) % 4..];
        out
    });
    let arrays = arrays.collect();
    let fields = header["records"]["fields"].as_array().unwrap();
    let name = |field: &Value| (field["name"].as_str().unwrap().to_owned(), Vec::new());
    let mut records: Vec<(String, Vec<f32>)> = fields.iter().map(name).collect();
    for _ in 0..number(&header["records"]["count"]) {
        let before = bytes.len();
        for (field, (_, values)) in fields.iter().zip(&mut records) {
            (0..number(&field["components"])).for_each(|k| values.push(value(field, k, &mut bytes)));
        }
        assert_eq!(before - bytes.len(), number(&header["records"]["stride"]));
    }
    assert!(bytes.is_empty(), "{} bytes are left", bytes.len());
    Read { header, arrays, records }
}

/// Gaussians with distinct values, including extreme ones.
/// The Gaussian of [`model`] that no photograph shows.
const UNPHOTOGRAPHED: usize = 9;

fn model() -> Model {
    let mut gaussians = Gaussians::zeroed(50, 2, 2, 1);
    let mut state = 7u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / 8_388_608.0 - 1.0
    };
    for (_, _, values) in gaussians.fields_mut() {
        values.iter_mut().for_each(|v| *v = random());
    }
    gaussians.field_mut(Field::SamplingRate).iter_mut().for_each(|rate| *rate = rate.abs());
    gaussians.row_mut(Field::SamplingRate, UNPHOTOGRAPHED)[0] = -1.0;
    gaussians.row_mut(Field::Mean, 3)[0] = 250.0;
    // Nearly round: the last digits decide the shortest axis.
    gaussians.row_mut(Field::LogScale, 4).copy_from_slice(&[-2.0, -2.000_001, -2.0]);
    gaussians.row_mut(Field::LogScale, 5).fill(-3.0);
    gaussians.row_mut(Field::LogScale, 6).fill(-70.0);
    gaussians.row_mut(Field::OpacityLogit, 7)[0] = 1e9;
    Model {
        world_scale: 0.5,
        world_offset: DVec3::new(1.0, 2.0, 3.0),
        ..Model::new(gaussians, vec![[0.1, 0.5, 0.9], [0.7, 0.3, 0.2]], vec![[0.0; 3]; 2], (2, 1))
    }
}

const FRAMING: Framing = Framing { eye: DVec3::X, target: DVec3::ZERO, fov_deg: 40.0 };

/// The greatest difference between the values of `field` and `truth`.
fn error(read: &Read, field: &str, truth: &[f32]) -> f64 {
    let (_, values) = read.records.iter().find(|(name, _)| name == field).unwrap();
    largest_difference(values, truth)
}

#[test]
fn stream_matches_the_model_within_quantisation_steps() {
    let model = model();
    let read = read(&encode_gaussians(&model, &FRAMING), b"RLMG");
    let order = importance_order(&model.gaussians);
    let rows = |g: &Gaussians, field: Field, most: f32| -> Vec<f32> {
        order.iter().flat_map(|&i| g.row(field, i)).map(|v| v.clamp(-most, most)).collect()
    };
    let albedo: Vec<f32> = order.iter().flat_map(|&i| crate::formats::splats::albedo(&model, i)).collect();
    for (name, field, most, step) in [
        ("mean", Field::Mean, 1e9, 0.0),
        ("log_scale", Field::LogScale, 60.0, 3e-3),
        ("opacity", Field::OpacityLogit, 12.0, 3e-4),
        ("normal", Field::Normal, 1e9, 6e-4),
        ("metal", Field::MetalLogit, 12.0, 2e-5),
        ("rough", Field::RoughLogit, 12.0, 2e-5),
        ("sheen", Field::Sheen, 3.0, 2e-5),
        ("sampling_rate", Field::SamplingRate, 1e9, 6e-4),
        ("visibility", Field::Visibility, 1e9, 4.1e-3),
    ] {
        let found = error(&read, name, &rows(&model.gaussians, field, most));
        assert!(found <= step, "{name}: {found}");
        let mut other = model.gaussians.clone();
        other.field_mut(field).iter_mut().for_each(|v| *v += 0.01);
        assert!(error(&read, name, &rows(&other, field, most)) > step, "the control: {name}");
    }
    assert!(error(&read, "albedo", &albedo) < 1e-5);
    assert_eq!(read.header["world_offset"], serde_json::json!([1.0, 2.0, 3.0]));
    assert_eq!(read.header["shading"]["normal"], "shortest_axis");
}

#[test]
fn stream_omits_gaussians_that_no_photograph_shows() {
    let model = model();
    let count = |model: &Model| {
        let read = read(&encode_gaussians(model, &FRAMING), b"RLMG");
        read.records.iter().find(|(name, _)| name == "opacity").unwrap().1.len()
    };
    assert_eq!(count(&model), 49);
    assert!(!importance_order(&model.gaussians).contains(&UNPHOTOGRAPHED));
    let mut shown = model;
    shown.gaussians.row_mut(Field::SamplingRate, UNPHOTOGRAPHED)[0] = 1.0;
    assert_eq!(count(&shown), 50, "the control");
}

#[test]
fn stream_has_photographed_views_of_models_that_record_them() {
    let header = |card| read(&encode_gaussians(&Model { card, ..model() }, &FRAMING), b"RLMG").header;
    let views = serde_json::json!({
        "target": [0.0, 0.0, 0.0], "radius": 1.0, "distance": 3.0, "azimuth_deg": 10.0, "elevation_deg": 20.0, "fov_deg": 40.0,
        "photographs": [{ "name": "a.jpg", "azimuth_deg": 10.0, "elevation_deg": 20.0 }],
    });
    assert_eq!(header(serde_json::json!({ "photographed_views": views }))["photographed_views"], views);
    for card in [serde_json::json!({}), serde_json::json!({ "photographed_views": { "radius": 1.0 } })] {
        assert_eq!(header(card).get("photographed_views"), None);
    }
}

#[test]
fn rotations_stay_unit_and_the_shortest_axis_is_preserved() {
    let model = model();
    let read = read(&encode_gaussians(&model, &FRAMING), b"RLMG");
    let field = |name: &str| &read.records.iter().find(|(n, _)| n == name).unwrap().1;
    let shortest = |s: &[f32]| (0..3).fold(0, |best, k| if s[k] < s[best] { k } else { best });
    for (row, &i) in importance_order(&model.gaussians).iter().enumerate() {
        let q = &field("quaternion")[4 * row..4 * row + 4];
        let length = q.iter().map(|v| v * v).sum::<f32>().sqrt();
        assert!((length - 1.0).abs() < 1e-4);
        let along: f32 = q.iter().zip(model.gaussians.row(Field::Quaternion, i)).map(|(a, b)| a * b).sum();
        let raw = model.gaussians.row(Field::Quaternion, i).iter().map(|v| v * v).sum::<f32>().sqrt();
        assert!((along / raw - 1.0).abs() < 1e-4, "{i}");
        let truth = model.gaussians.get::<3>(Field::LogScale, i).map(|s| s.clamp(-60.0, 60.0));
        assert_eq!(shortest(&field("log_scale")[3 * row..3 * row + 3]), shortest(&truth), "{i}");
    }
}

#[test]
fn important_gaussians_come_first() {
    let mut g = Gaussians::zeroed(5, 1, 0, 0);
    for (i, (scale, logit)) in
        [(0.1f32, 0.0), (0.2, 0.0), (0.1, 5.0), (0.2, 0.0), (9.0, -40.0)].iter().enumerate()
    {
        g.row_mut(Field::LogScale, i).fill(scale.ln());
        g.row_mut(Field::OpacityLogit, i)[0] = *logit;
    }
    assert_eq!(importance_order(&g), [1, 3, 2, 0, 4], "ties by index");
}

#[test]
fn strong_lights_round_trip_through_the_stream() {
    let strong = 1e6f32;
    let surface = |i: usize| StreamedSurface {
        gathered: [0.1 * i as f32, 0.2, 0.3],
        blocked: [0.0, strong * i as f32, 1.0],
        arriving: [1.0, 0.25 * i as f32, 0.0, 0.5],
    };
    let lights = [SplitLight { direction: [0.0, 0.6, 0.8], radius: 0.01 }];
    let light = StreamedLight {
        reflectance: vec![0.1, 0.2, 0.3],
        tables: (0..31).map(|i| i as f32 * strong).collect(),
        diffuse_nodes: 3,
        coefficients: 16,
        specular_nodes: vec![5, 3],
        lights: &lights,
        surfaces: (0..4).map(surface).collect(),
        map: Some(EnvMap::constant(4, 2, [0.5, 1.0, 2.0])),
    };
    let read = read(&encode_light(&light), b"RLML");
    assert_eq!(read.arrays[0], light.reflectance);
    for (a, b) in read.arrays[1].iter().zip(&light.tables) {
        assert!((a - b).abs() <= 5e-4 * b, "{a} {b}");
    }
    assert_eq!(read.arrays[2].len(), 4 * 2 * 3);
    assert!((read.arrays[2][23] - 2.0).abs() < 1e-3);
    let of = |pick: &dyn Fn(&StreamedSurface) -> [f32; 3]| -> Vec<f32> {
        light.surfaces.iter().flat_map(pick).collect()
    };
    assert!(error(&read, "gathered", &of(&|s| s.gathered)) < 2e-4);
    assert!(error(&read, "blocked", &of(&|s| s.blocked)) <= 1e-3 * 3.0 * f64::from(strong));
    let arriving: Vec<f32> = light.surfaces.iter().flat_map(|s| s.arriving).collect();
    assert_eq!(arriving.len(), 4 * MAX_LIGHTS);
    assert!(error(&read, "arriving", &arriving) < 2e-3);
    assert_eq!(read.header["lights"][0]["direction"][1], serde_json::json!(0.6f32));
}

#[test]
fn empty_model_gives_a_valid_stream() {
    let model = Model { gaussians: Gaussians::zeroed(0, 2, 2, 1), ..model() };
    assert_eq!(read(&encode_gaussians(&model, &FRAMING), b"RLMG").header["records"]["count"], 0);
}
