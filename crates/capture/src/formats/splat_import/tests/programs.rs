//! PLY files as other programs write them.

use super::*;
use crate::formats::splats::Y_0;

/// An ASCII file with the given properties and rows.
fn ascii(properties: &[&str], rows: &[&[f64]]) -> Vec<u8> {
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {}\n", rows.len());
    properties.iter().for_each(|p| text += &format!("property {p}\n"));
    text += "end_header\n";
    for row in rows {
        text += &row.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ");
        text += "\n";
    }
    text.into_bytes()
}

const CLASSIC: [&str; 14] = [
    "float x",
    "float y",
    "float z",
    "float f_dc_0",
    "float f_dc_1",
    "float f_dc_2",
    "float opacity",
    "float scale_0",
    "float scale_1",
    "float scale_2",
    "float rot_0",
    "float rot_1",
    "float rot_2",
    "float rot_3",
];

fn row(x: f64) -> [f64; 14] {
    [x, 0.5, -0.5, 0.1, 0.2, 0.3, 1.0, -2.0, -3.0, -4.0, 1.0, 0.0, 0.0, 0.0]
}

/// A classic file of four splats whose second row is changed.
fn with_second(change: impl FnOnce(&mut [f64; 14])) -> Vec<u8> {
    let mut rows = [row(0.0), row(1.0), row(2.0), row(3.0)];
    change(&mut rows[1]);
    ascii(&CLASSIC, &rows.each_ref().map(|r| &r[..]))
}

fn with_comment(bytes: &[u8], comment: &str) -> Vec<u8> {
    let text = String::from_utf8(bytes.to_vec()).unwrap();
    text.replace("element vertex", &format!("comment {comment}\nelement vertex")).into_bytes()
}

#[test]
fn classic_files_have_no_compensation_unless_stated() {
    let classic = with_second(|_| ());
    let is_mip = |bytes: &[u8]| imported(bytes).shading.low_pass_compensation;
    assert!(!is_mip(&classic));
    for (comment, right) in [
        ("SplatRenderMode: mip", true),
        ("splatrendermode: MIP", true),
        ("SplatRenderMode: default", false),
        ("SplatRenderMode: 2dgs", false),
        ("antialiased 1", true),
        ("antialiased 0", false),
        ("exported by hand", false),
    ] {
        assert_eq!(is_mip(&with_comment(&classic, comment)), right, "{comment}");
    }
    let back = imported(&classic);
    let rewritten = ply_model::encode_splats(&back, &Splats::of(&back), PlyProperties::Ordinary);
    assert!(String::from_utf8_lossy(&rewritten).contains("SplatRenderMode: default\n"));
    assert!(!is_mip(&rewritten));
}

#[test]
fn infinite_opacities_and_log_scales_are_read() {
    let opaque = imported(&with_second(|row| row[6] = f64::INFINITY));
    assert_eq!((opaque.gaussians.len(), Splats::of(&opaque).opacity(1)), (4, 1.0));
    let hidden = decode(&with_second(|row| row[6] = f64::NEG_INFINITY)).unwrap();
    assert_eq!(hidden.model.gaussians.len(), 3);
    assert!(hidden.notes[0].contains("1 of 4 splats") && hidden.notes[0].contains("opacity is 0"));
    assert_eq!(hidden.model.card["imported"]["notes"][0], hidden.notes[0].as_str());
    let flat = imported(&with_second(|row| row[9] = f64::NEG_INFINITY));
    let scale = Splats::of(&flat).scale(1);
    assert!((scale[0] - (-2f32).exp()).abs() < 1e-5 && scale[2] < 2e-6 && scale[2] > 0.0, "{scale:?}");
    let whole = decode(&with_second(|_| ())).unwrap();
    assert!(whole.notes.is_empty() && whole.model.card["imported"]["notes"].is_null(), "the control");
}

#[test]
fn single_broken_splats_are_left_out_with_a_count() {
    for column in 0..14 {
        for value in [f64::NAN, f64::INFINITY, -1e30] {
            let import = decode(&with_second(|row| row[column] = value)).unwrap();
            let is_small_scale = (7..10).contains(&column) && value < 0.0;
            let is_kept = is_small_scale || column == 6 && value > 0.0;
            assert_eq!(import.model.gaussians.len(), if is_kept { 4 } else { 3 }, "{column} {value}");
            if !(is_kept || column == 6 && value < 0.0) {
                let note = &import.notes[0];
                assert!(note.contains("1 of 4 splats") && note.contains("vertex 1"), "{note}");
            }
        }
    }
}

#[test]
fn rotations_of_zero_become_the_identity_with_a_count() {
    let import = decode(&with_second(|row| row[10..].fill(0.0))).unwrap();
    assert_eq!(import.model.gaussians.row(Field::Quaternion, 1), [1.0, 0.0, 0.0, 0.0]);
    let note = &import.notes[0];
    assert!(note.contains("1 of 4 splats") && note.contains("rotation of zero"), "{note}");
    assert!(note.ends_with("vertex 1") && import.notes.len() == 1, "{:?}", import.notes);
    let unnormalised = decode(&with_second(|row| row[10..].copy_from_slice(&[0.0, 0.0, 0.0, 1e-3]))).unwrap();
    assert!(unnormalised.notes.is_empty(), "the control: {:?}", unnormalised.notes);
}

#[test]
fn huge_splats_are_counted_and_overflowing_ones_left_out() {
    // The four centres lie within 2 units of their median.
    let with_size = |size: f64| decode(&with_second(|row| row[8] = size.ln())).unwrap();
    let huge = with_size(40.0);
    let note = &huge.notes[0];
    assert!(note.contains("1 of 4 splats are larger than 10 times the radius"), "{note}");
    assert!(note.ends_with("vertex 1") && huge.model.gaussians.len() == 4, "{note}");
    assert_eq!(huge.model.card["imported"]["notes"][0], note.as_str());
    assert!(with_size(9.0).notes.is_empty(), "the control: a large one, as of the sky");
    let overflowing = decode(&with_second(|row| row[8] = 90.0)).unwrap();
    assert_eq!(overflowing.model.gaussians.len(), 3);
    assert!(overflowing.notes[0].contains("above 1e12"), "{:?}", overflowing.notes);
}

#[test]
fn files_with_mostly_broken_or_no_splats_are_refused() {
    let mut broken = row(0.0);
    broken[0] = f64::NAN;
    let refused = |rows: &[&[f64]]| decode(&ascii(&CLASSIC, rows)).unwrap_err().to_string();
    let text = refused(&[&row(0.0), &broken, &broken]);
    assert!(text.contains("vertex 1") && text.contains("2 of 3"), "{text}");
    assert!(decode(&ascii(&CLASSIC, &[&row(0.0), &broken])).is_ok(), "the control: half of them");
    assert!(refused(&[]).contains("no splats"));
    let mut hidden = row(0.0);
    hidden[6] = f64::NEG_INFINITY;
    assert!(refused(&[&hidden, &hidden]).contains("opacity"));
}

#[test]
fn flat_splats_of_2dgs_are_read() {
    let without = |r: [f64; 14]| [&r[..9], &r[10..]].concat();
    let properties: Vec<&str> = CLASSIC.into_iter().filter(|p| *p != "float scale_2").collect();
    let import = decode(&ascii(&properties, &[&without(row(0.0)), &without(row(1.0))])).unwrap();
    let scale = Splats::of(&import.model).scale(1);
    assert!((scale[1] - (-3f32).exp()).abs() < 1e-5 && (scale[2] - 1e-6).abs() < 1e-7, "{scale:?}");
    assert!(import.notes[0].contains("2DGS"), "{:?}", import.notes);
    assert!(!import.model.shading.low_pass_compensation);
}

#[test]
fn colours_without_harmonics_are_read() {
    let properties = [&CLASSIC[..3], &["uchar red", "uchar green", "uchar blue"], &CLASSIC[6..]].concat();
    let mut first = row(0.0);
    first[3..6].copy_from_slice(&[255.0, 0.0, 51.0]);
    let model = imported(&ascii(&properties, &[&first, &first]));
    assert_eq!(model.gaussians.radiance_degree(), 0);
    let shown = Splats::of(&model).harmonics(1)[0].map(|c| 0.5 + Y_0 * c);
    assert!(near(&shown, &[1.0, 0.0, 0.2]), "{shown:?}");
}

#[test]
fn point_clouds_are_named() {
    let properties = ["float x", "float y", "float z", "uchar red", "uchar green", "uchar blue"];
    let error = decode(&ascii(&properties, &[&[0.0; 6]])).unwrap_err().to_string();
    assert!(error.contains("point cloud") && error.contains("red"), "{error}");
}

#[test]
fn values_of_unused_columns_may_be_anything() {
    let properties = [&CLASSIC[..], &["float lod"]].concat();
    let rows = [[&row(0.0)[..], &[f64::NAN]].concat(), [&row(1.0)[..], &[f64::INFINITY]].concat()];
    let import = decode(&ascii(&properties, &[&rows[0], &rows[1]])).unwrap();
    assert_eq!((import.model.gaussians.len(), import.notes.len()), (2, 0));
}
