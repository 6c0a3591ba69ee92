//! Real captures with known content.

use std::collections::BTreeMap;
use std::path::PathBuf;

use glam::{DVec2, DVec3};
use relume_capture::formats::environment;
use relume_capture::{Capture, Distortion, ImportOptions, UndecodedCapture, Up, WorldUp, import};

use relume_fixtures::data;
use relume_spec::training::TurntableCapture;

fn small(path: PathBuf, side: u32) -> Capture {
    import(&path, &ImportOptions { max_side: Some(side), ..ImportOptions::default() }).unwrap()
}

#[test]
#[ignore = "needs RELUME_TEST_DATA (see CONTRIBUTING.md)"]
fn lego_has_100_masked_views_around_the_origin() {
    let path = data("captures/lego");
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
#[ignore = "needs RELUME_TEST_DATA (see CONTRIBUTING.md)"]
fn helmet_is_imported_with_ground_truth_and_lights() {
    let path = data("scenes/helmet");
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
        for (i, pixel) in view.image.pixels().enumerate() {
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

#[test]
#[ignore = "needs RELUME_TEST_DATA (see CONTRIBUTING.md)"]
fn fox_import_warns_of_17_missing_images() {
    let path = data("captures/fox");
    let capture = small(path, 240);
    assert_eq!((capture.layout.as_str(), capture.train.len() + capture.test.len()), ("nerfstudio", 50));
    assert_eq!(capture.test.len(), 7, "every 8th of 50");
    let warning = &capture.warnings[0];
    assert!(warning.contains("names: 17 of 67"), "{warning}");
    assert_eq!(warning.matches("images/").count(), 17, "{warning}");
    assert!(!capture.has_alpha && capture.train.iter().all(|v| v.image.is_opaque()));
    assert_eq!((capture.train[0].camera.width, capture.train[0].camera.height), (135, 240));
    for view in &capture.train {
        let toward = (capture.bounds.centre - view.camera.centre()).normalize();
        assert!(view.camera.forward().dot(toward) > 0.8, "{} looks away from the subject", view.name);
        assert!(-view.camera.rotation.row(1).z > 0.5, "{} is not upright", view.name);
    }
}

/// Share of point-in-view pairs, over points near the object, that are inside the image.
fn share_in_view(capture: &Capture, mirror: f64) -> f64 {
    let (mut inside, mut all) = (0, 0);
    for view in capture.train.iter().chain(&capture.test) {
        let c = &view.camera;
        for (point, _) in &capture.points {
            if (*point - capture.bounds.centre).length() > 0.5 * capture.bounds.radius {
                continue;
            }
            let p = c.rotation * *point * mirror + c.translation;
            let (u, v) = (c.fx * p.x / p.z + c.cx, c.fy * p.y / p.z + c.cy);
            let seen = p.z > 0.0 && u >= 0.0 && v >= 0.0 && u < f64::from(c.width) && v < f64::from(c.height);
            inside += usize::from(seen);
            all += 1;
        }
    }
    f64::from(inside as u32) / f64::from(all as u32)
}

#[test]
#[ignore = "needs RELUME_TEST_DATA (see CONTRIBUTING.md)"]
fn colmap_points_project_into_their_images() {
    for (name, images) in [("captures/fox9_colmap", 9), ("captures/beer71_colmap", 71)] {
        let path = data(name);
        let capture = small(path, 320);
        assert_eq!((capture.layout.as_str(), capture.train.len() + capture.test.len()), ("colmap", images));
        assert_eq!(capture.warnings, Vec::<String>::new());
        assert!(capture.points.len() > 500 && !capture.has_alpha);
        let (share, mirrored) = (share_in_view(&capture, 1.0), share_in_view(&capture, -1.0));
        eprintln!("{name}: {share} {mirrored} {:?}", capture.bounds);
        assert!(share > 0.7 && mirrored < 0.3, "{name}: {share} {mirrored}");
    }
}

/// The angle between the up direction of an import and a plane's normal in the axes of the files, degrees.
fn angle_to(normal: DVec3, up: &WorldUp) -> f64 {
    DVec3::from_array(up.direction).angle_between(normal).to_degrees()
}

#[test]
#[ignore = "needs RELUME_TEST_DATA (see CONTRIBUTING.md)"]
fn beer_stands_on_a_level_floor() {
    // A robust fit (Tukey's weights) to the grey points beside the can; three walls are perpendicular to it within 1.1 degrees.
    let floor = DVec3::new(-0.080529, -0.928410, -0.362725).normalize();
    let of = |up| {
        let options = ImportOptions { up, ..ImportOptions::default() };
        UndecodedCapture::open(&data("captures/beer71_colmap"), &options).unwrap().up().clone()
    };
    let (found, mean) = (of(Up::AUTO), of(Up::MEAN));
    assert!(angle_to(floor, &found) < 0.5 && found.note.as_ref().unwrap().contains("plane"), "{found:?}");
    assert!(angle_to(floor, &mean) > 20.0, "the control: {mean:?}");
}

#[test]
#[ignore = "needs RELUME_TEST_DATA (see CONTRIBUTING.md)"]
fn fox_hangs_on_a_vertical_wall() {
    // A least squares fit to the points of the wall in `fox9_colmap`, in the axes of `fox/transforms.json`.
    let wall = DVec3::new(0.871544, -0.483066, -0.084010).normalize();
    let of = |up| {
        let options = ImportOptions { up, ..ImportOptions::default() };
        UndecodedCapture::open(&data("captures/fox"), &options).unwrap().up().clone()
    };
    let lean = |up: &WorldUp| (angle_to(wall, up) - 90.0).abs();
    let (found, stated) = (of(Up::AUTO), of(Up::MEAN));
    assert!(lean(&found) < 2.0 && found.note.as_ref().unwrap().contains("held level"), "{found:?}");
    assert!(lean(&stated) > 4.0, "the control: {stated:?}");
}

#[test]
#[ignore = "needs RELUME_TEST_DATA (see CONTRIBUTING.md)"]
fn head_on_a_turntable_is_recognised() {
    // The azimuths of the cameras about the axis of the stand, from the poses alone: eigenvector of the relative rotations.
    let expected = [0.0, 3.8, 8.0, 12.8, 17.1, 20.7, 25.3, 30.0, 32.7, 38.7];
    let mut options = ImportOptions { max_side: Some(160), ..ImportOptions::default() };
    let capture = import(&data("captures/head66_llff"), &options).unwrap();
    assert!(
        capture.turntable.as_ref().is_some_and(|note| note.contains("stands still")),
        "{:?}",
        capture.turntable
    );
    let mut views: Vec<_> = capture.train.iter().chain(&capture.test).collect();
    views.sort_by(|a, b| a.name.cmp(&b.name));
    for (view, expected) in views.iter().zip(expected) {
        let difference = (view.light_rotation_deg - expected).abs();
        assert!(difference < 1.5, "{}: {}", view.name, view.light_rotation_deg);
    }
    options.turntable = TurntableCapture::No;
    assert_eq!(import(&data("captures/head66_llff"), &options).unwrap().turntable, None, "the control");
}

/// COLMAP's measurements per image name: the lens `[f, cx, cy, k]` and observations `(x, y, index of point)`.
struct Measured {
    images: BTreeMap<String, MeasuredImage>,
}

type MeasuredImage = ([f64; 4], Vec<(DVec2, usize)>);

/// Walks a SIMPLE_RADIAL binary model by hand, apart from the importer's own reader.
fn measured(folder: PathBuf) -> Measured {
    struct Cursor(Vec<u8>, usize);
    impl Cursor {
        fn bytes<const N: usize>(&mut self) -> [u8; N] {
            self.1 += N;
            self.0[self.1 - N..self.1].try_into().unwrap()
        }
        fn long(&mut self) -> usize {
            u64::from_le_bytes(self.bytes()) as usize
        }
        fn int(&mut self) -> u32 {
            u32::from_le_bytes(self.bytes())
        }
        fn float(&mut self) -> f64 {
            f64::from_le_bytes(self.bytes())
        }
    }
    let open = |name: &str| Cursor(std::fs::read(folder.join(name)).unwrap(), 0);
    let (mut cameras, mut images, mut points) =
        (open("cameras.bin"), open("images.bin"), open("points3D.bin"));
    let mut lenses = BTreeMap::new();
    for _ in 0..cameras.long() {
        let (id, model) = (cameras.int(), cameras.int());
        assert_eq!(model, 2, "SIMPLE_RADIAL");
        let _size = [cameras.long(), cameras.long()];
        lenses.insert(id, [(); 4].map(|()| cameras.float()));
    }
    let mut order = BTreeMap::new();
    for i in 0..points.long() {
        order.insert(points.long(), i);
        points.1 += 24 + 3 + 8;
        points.1 += points.long() * 8;
    }
    let mut out = BTreeMap::new();
    for _ in 0..images.long() {
        images.1 += 4 + 56;
        let camera = images.int();
        let mut name = String::new();
        loop {
            match images.bytes::<1>() {
                [0] => break,
                [c] => name.push(c as char),
            }
        }
        let count = images.long();
        let seen = (0..count).map(|_| (images.float(), images.float(), images.long()));
        let seen = seen.filter_map(|(x, y, id)| Some((DVec2::new(x, y), *order.get(&id)?))).collect();
        out.insert(format!("images/{name}"), (lenses[&camera], seen));
    }
    Measured { images: out }
}

/// Median distance, in stored pixels, between where a point was observed and where the imported camera puts it,
/// over the outer part of the image, where the lens bends: it moves points by 2 px at 400 px from the middle.
fn reprojection_error(capture: &Capture, measured: &Measured, bend: f64) -> f64 {
    let mut errors = Vec::new();
    for view in capture.train.iter().chain(&capture.test) {
        let ([f, cx, cy, k], seen) = &measured.images[&view.name];
        let lens = Distortion::RadialTangential { k: [k * bend, 0.0, 0.0, 0.0], p: [0.0; 2] };
        let c = &view.camera;
        let middle = DVec2::new(*cx, *cy);
        for (at, point) in seen.iter().filter(|(at, _)| at.distance(middle) > 400.0) {
            let straight = lens.undistort((*at - middle) / f).unwrap();
            let p = c.rotation * capture.points[*point].0 + c.translation;
            let difference = straight - DVec2::new(p.x, p.y) / p.z;
            errors.push((difference * *f).length());
        }
    }
    errors.sort_by(f64::total_cmp);
    assert!(errors.len() > 2_000, "{}", errors.len());
    errors[errors.len() / 2]
}

#[test]
#[ignore = "needs RELUME_TEST_DATA (see CONTRIBUTING.md)"]
fn observations_match_undistorted_cameras_within_one_pixel() {
    let path = data("captures/beer71_colmap");
    let capture = small(path.clone(), 160);
    let measured = measured(path.join("sparse/0"));
    let [right, none, opposite] = [1.0, 0.0, -1.0].map(|bend| reprojection_error(&capture, &measured, bend));
    eprintln!("median reprojection error {right} px; no lens {none} px; the opposite lens {opposite} px");
    assert!(right < 1.0 && none > 2.0 * right && opposite > 4.0 * right, "{right} {none} {opposite}");
}

#[test]
#[ignore = "needs RELUME_TEST_DATA (see CONTRIBUTING.md)"]
fn environments_load_and_negative_values_give_warnings() {
    let folder = data("envmaps");
    for name in ["bridge", "city", "dawn", "forest", "interior", "night", "studio", "sunset"] {
        let loaded =
            environment::decode(&std::fs::read(folder.join(format!("{name}.hdr"))).unwrap()).unwrap();
        assert_eq!(
            (loaded.map.width(), loaded.map.height(), loaded.warnings.len()),
            (1024, 512, 0),
            "{name}"
        );
    }
    for name in ["negative_pixels.exr", "dwa_studio.exr"] {
        let loaded = environment::decode(&std::fs::read(folder.join(name)).unwrap()).unwrap();
        assert!(loaded.warnings[0].contains("negative"), "{name}: {:?}", loaded.warnings);
        assert!(loaded.map.texels().iter().flatten().all(|v| *v >= 0.0));
        eprintln!("{name} {}x{} {:?}", loaded.map.width(), loaded.map.height(), loaded.warnings);
    }
}
