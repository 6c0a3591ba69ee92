//! Real captures with known content.

use std::path::PathBuf;

use relume::capture::{Capture, ImportOptions, import};

/// A path in the test data, or nothing, said aloud, when the data is not there.
fn data(relative: &str) -> Option<PathBuf> {
    let default = concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data");
    let root = std::env::var("RELUME_TEST_DATA").unwrap_or_else(|_| default.to_owned());
    let path = PathBuf::from(root).join(relative);
    if path.exists() {
        return Some(path);
    }
    eprintln!("SKIPPED: the test data has no {relative} (set RELUME_TEST_DATA)");
    None
}

fn small(path: PathBuf, side: u32) -> Capture {
    import(&path, &ImportOptions { max_side: Some(side), ..ImportOptions::default() }).unwrap()
}

#[test]
fn lego_is_a_hundred_cut_out_views_around_the_origin() {
    let Some(path) = data("captures/lego") else { return };
    let capture = small(path, 100);
    assert_eq!(
        (capture.layout.as_str(), capture.train.len(), capture.test.len()),
        ("nerf-synthetic", 100, 25)
    );
    assert!(capture.has_alpha);
    assert!(capture.bounds.centre.length() < 0.2, "{:?}", capture.bounds);
    assert!((1.2..1.6).contains(&capture.bounds.radius), "{:?}", capture.bounds);
    for view in capture.train.iter().chain(&capture.test) {
        assert_eq!((view.image.width, view.camera.width), (100, 100));
        assert!((view.camera.fx - 1111.1 / 8.0).abs() < 0.1);
        assert!((view.camera.centre().length() - 4.031).abs() < 0.01);
        assert!(view.camera.centre().z > -1.0 && view.camera.forward().dot(view.camera.centre()) < -3.9);
    }
}

#[test]
fn helmet_comes_with_its_truth_and_its_lights() {
    let Some(path) = data("scenes/helmet") else { return };
    let capture = small(path, 200);
    assert_eq!((capture.layout.as_str(), capture.train.len(), capture.test.len()), ("tensoir", 80, 16));
    assert!((1.1..1.5).contains(&capture.bounds.radius), "{:?}", capture.bounds);
    assert_eq!(capture.lights.keys().collect::<Vec<_>>(), ["bridge", "city", "interior", "night"]);
    assert_eq!(capture.warnings, Vec::<String>::new());
    for view in &capture.test {
        assert_eq!(view.truth.relit.keys().collect::<Vec<_>>(), ["bridge", "city", "interior", "night"]);
        let truth = &view.truth;
        let (albedo, normal) = (truth.albedo.as_ref().unwrap(), truth.normal.as_ref().unwrap());
        let (depth, ao) = (truth.depth.as_ref().unwrap(), truth.ambient_occlusion.as_ref().unwrap());
        let material = truth.metallic_roughness.as_ref().unwrap();
        let mut facing = 0;
        let mut covered = 0;
        for (i, pixel) in view.image.pixels.iter().enumerate() {
            if pixel[3] < 0.99 {
                continue;
            }
            covered += 1;
            let (x, y) = (i as u32 % 200, i as u32 / 200);
            let n = glam::Vec3::from(normal.values[i]).as_dvec3();
            facing += usize::from(n.dot(view.camera.ray(x, y)) < 0.1);
            assert!((n.length() - 1.0).abs() < 1e-3);
            assert!((1.0..6.0).contains(&depth.values[i][0]), "{}", depth.values[i][0]);
            let all = [&albedo.values[i][..], &ao.values[i], &material.values[i]];
            assert!(all.iter().flat_map(|v| v.iter()).all(|v| (0.0..=1.0).contains(v)));
        }
        assert!(facing as f64 > 0.98 * covered as f64, "normals face the camera: {facing} of {covered}");
    }
}
