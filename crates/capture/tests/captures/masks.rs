//! Masks in every form that programs write, and masks that leave the wrong pixels.

use relume_capture::formats::image_file;
use relume_capture::{Capture, CaptureError};
use relume_fixtures::small_set::{Files, colmap, import_folder, nerfstudio};

/// Values of a mask of 8x6 pixels: `inside` in the middle 4x2, `outside` elsewhere.
fn grey(inside: u8, outside: u8) -> Vec<u8> {
    let is_inside = |i: usize| (2..6).contains(&(i % 8)) && (2..4).contains(&(i / 8));
    let pixels: Vec<[u8; 1]> = (0..48).map(|i| [if is_inside(i) { inside } else { outside }]).collect();
    image_file::encode_png(8, 6, &pixels).unwrap()
}

/// A capture of six opaque photographs, with the mask `mask` of each photograph at the path that `name` returns.
fn with_masks(name: impl Fn(&str) -> String, mask: &[u8]) -> Files {
    let mut files = nerfstudio(|_| ());
    for i in 0..6 {
        let opaque = image_file::encode_png(8, 6, &[[90u8, 60, i * 10]; 48]).unwrap();
        files.insert(format!("images/{i}.png"), opaque);
        files.insert(name(&i.to_string()), mask.to_vec());
    }
    files
}

/// The share of pixels of the object, the same in every photograph.
fn share(capture: &Capture) -> f32 {
    let share = |view: &relume_capture::CaptureView| {
        let alpha = view.image.alpha();
        alpha.iter().sum::<f32>() / alpha.len() as f32
    };
    let shares: Vec<f32> = capture.train.iter().chain(&capture.test).map(share).collect();
    assert!(shares.iter().all(|s| (s - shares[0]).abs() < 1e-6), "{shares:?}");
    shares[0]
}

fn imported(files: &Files) -> Result<(f32, Vec<String>), CaptureError> {
    import_folder(files).map(|capture| (share(&capture), capture.warnings))
}

const OBJECT: f32 = 8.0 / 48.0;

#[test]
fn masks_of_every_common_name_are_used() {
    let forms: [fn(&str) -> String; 11] = [
        |n| format!("masks/{n}.png"),
        |n| format!("masks/{n}.PNG"),
        |n| format!("masks/{n}.png.png"),
        |n| format!("masks/{n}.jpg"),
        |n| format!("Masks/{n}.png"),
        |n| format!("masks/{n}_mask.png"),
        |n| format!("segmentation/{n}.png"),
        |n| format!("images/{n}.mask.png"),
        |n| format!("images/{n}.png.mask.png"),
        |n| format!("images/{n}_mask.png"),
        |n| format!("object_masks/{n}.webp"),
    ];
    for form in forms {
        let (share, warnings) = imported(&with_masks(form, &grey(255, 0))).unwrap();
        assert!((share - OBJECT).abs() < 1e-6 && warnings.is_empty(), "{}: {share} {warnings:?}", form("0"));
    }
    let (none, _) = imported(&with_masks(|n| format!("notes/{n}.png"), &grey(255, 0))).unwrap();
    assert_eq!(none, 1.0, "the control: no masks");
}

#[test]
fn labels_alpha_and_hiding_masks_are_read() {
    let named = |n: &str| format!("masks/{n}.png");
    let rgba = |inside: u8, outside: u8| {
        let pixels: Vec<[u8; 4]> = image_file::decode(&grey(inside, outside), 100)
            .unwrap()
            .pixels
            .iter()
            .map(|p| [180, 20, 90, (p[0] * 255.0).round() as u8])
            .collect();
        image_file::encode_png(8, 6, &pixels).unwrap()
    };
    for files in [
        with_masks(named, &grey(1, 0)),
        with_masks(named, &rgba(255, 0)),
        with_masks(|n| format!("images/dynamic_mask_{n}.png"), &grey(0, 255)),
    ] {
        let (share, warnings) = imported(&files).unwrap();
        assert!((share - OBJECT).abs() < 1e-6 && warnings.is_empty(), "{share} {warnings:?}");
    }
}

#[test]
fn masks_that_leave_no_object_are_refused() {
    let named = |n: &str| format!("masks/{n}.png");
    let refused = |files: &Files| imported(files).unwrap_err().to_string();
    let empty = refused(&with_masks(named, &grey(0, 0)));
    assert!(
        empty.contains("images/") && empty.contains("no photograph has a pixel of the object"),
        "{empty}"
    );
    let mut transparent = nerfstudio(|_| ());
    for i in 0..6 {
        transparent
            .insert(format!("images/{i}.png"), image_file::encode_png(8, 6, &[[9u8, 9, 9, 0]; 48]).unwrap());
    }
    assert!(refused(&transparent).contains("no photograph has a pixel of the object"));
    let other = image_file::encode_png(6, 8, &[[255u8]; 48]).unwrap();
    let other = refused(&with_masks(named, &other));
    assert!(other.contains("masks/0.png") && other.contains("6 x 8") && other.contains("8 x 6"), "{other}");
    let mut one_empty = with_masks(named, &grey(255, 0));
    one_empty.insert("masks/3.png".into(), grey(0, 0));
    let warnings = import_folder(&one_empty).unwrap().warnings;
    assert!(warnings.len() == 1 && warnings[0].contains("photographs with an empty mask: 1: images/3.png"));
}

#[test]
fn inverted_masks_are_reported_by_photograph() {
    // The middle third of each side is hidden.
    let pixels: Vec<[u8; 1]> =
        (0..36 * 24).map(|i| [if (i % 36) / 12 == 1 && (i / 36) / 8 == 1 { 0 } else { 255 }]).collect();
    let mask = image_file::encode_png(36, 24, &pixels).unwrap();
    let mut files = with_masks(|n| format!("masks/{n}.png"), &mask);
    for i in 0..6 {
        let photo = image_file::encode_png(36, 24, &[[90u8, 60, i * 10]; 36 * 24]).unwrap();
        files.insert(format!("images/{i}.png"), photo);
    }
    let json = String::from_utf8(files["transforms.json"].clone()).unwrap();
    let json = json.replace("\"w\":8", "\"w\":36").replace("\"h\":6", "\"h\":24");
    files.insert("transforms.json".into(), json.into_bytes());
    let warnings = import_folder(&files).unwrap().warnings;
    assert!(warnings.iter().any(|w| w.contains("invert") && w.contains("images/5.png")), "{warnings:?}");
}

#[test]
fn unused_and_missing_masks_are_reported() {
    let (share, warnings) = imported(&with_masks(|n| format!("masks/shot_{n}.png"), &grey(255, 0))).unwrap();
    assert_eq!(share, 1.0);
    assert!(warnings.len() == 1 && warnings[0].starts_with("masks: 6, used: 0; not used: masks/shot_0.png"));
    let mut files = with_masks(|n| format!("masks/{n}.png"), &grey(255, 0));
    files.remove("masks/1.png");
    files.remove("masks/4.png");
    let warnings = import_folder(&files).unwrap().warnings;
    assert!(
        warnings.len() == 1 && warnings[0].starts_with("photographs without a mask: 2 of 6"),
        "{warnings:?}"
    );
    assert!(warnings[0].ends_with("images/1.png, images/4.png"), "{warnings:?}");
}

#[test]
fn masks_of_a_colmap_model_are_found_as_well() {
    let mut files = colmap();
    for i in 0..4 {
        files.insert(format!("masks/{i}.png.png"), grey(255, 0));
    }
    let capture = import_folder(&files).unwrap();
    let object: f32 = capture.train[0].image.alpha().iter().sum();
    assert_eq!(object, 8.0);
}
