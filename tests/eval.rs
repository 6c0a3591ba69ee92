//! Evaluation through the public API: LPIPS against the values of its authors, and a model against its own
//! renderings.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use glam::DVec3;
use relume::cli::eval::{EvalArgs, QualityArgs, run};
use relume_capture::formats::model_file;
use relume_capture::{Capture, CaptureView, GroundTruthView, SceneBounds};
use relume_engine::{Device, DeviceChoice};
use relume_scene::{
    BitDepth, Camera, EnvMap, Field, Gaussians, ImageRgba, Model, PackedImage, Plane, ShadeAt, ShadingOptions,
};
use relume_spec::rendering::{Output, Tier};
use relume_train::eval::{
    CELL, DisplayImage, EvalError, EvalOptions, Lpips, Report, SheetFormat, SheetRows, TruthLayer, attribute,
    contact_sheet, evaluate,
};
use relume_train::render::{Frame, Renderer};

const SIDE: u32 = 40;

/// A few large Gaussians of several colours around the origin.
fn model() -> Model {
    let mut gaussians = Gaussians::zeroed(9, 2, 0, 0);
    for i in 0..9 {
        let angle = i as f32 * 0.7;
        gaussians.row_mut(Field::Mean, i).copy_from_slice(&[
            0.5 * angle.cos(),
            0.5 * angle.sin(),
            0.1 * i as f32 - 0.4,
        ]);
        gaussians.row_mut(Field::LogScale, i).copy_from_slice(&[-1.2, -1.4, -2.5]);
        gaussians.row_mut(Field::Quaternion, i).copy_from_slice(&[1.0, angle.sin(), 0.3, 0.1]);
        gaussians.row_mut(Field::OpacityLogit, i).fill(5.0);
        gaussians.row_mut(Field::ProtoLogits, i).copy_from_slice(&[i as f32 - 4.0, 0.0]);
        gaussians.row_mut(Field::Visibility, i).fill(3.0);
        gaussians.row_mut(Field::Radiance, i).copy_from_slice(&[0.4, 0.1 * i as f32, 0.2]);
    }
    Model {
        card: serde_json::json!({"training_seconds": 12.5}),
        ..Model::new(gaussians, vec![[0.5, 0.3, 0.2], [0.2, 0.3, 0.4]], vec![[0.3; 3]; 512], (32, 16))
    }
}

fn straight(frame: &Frame, output: Output) -> ImageRgba {
    let curve = |v: f32| if v <= 0.0031308 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
    let colours = frame.planes[&output].as_chunks::<3>().0;
    let pixel = |(c, a): (&[f32; 3], &f32)| {
        let [r, g, b] = c.map(|v| curve((v / a.max(1e-6)).clamp(0.0, 1.0)));
        [r, g, b, *a]
    };
    let pixels = colours.iter().zip(&frame.planes[&Output::Alpha]).map(pixel).collect();
    ImageRgba { width: frame.width, height: frame.height, pixels }
}

fn plane<const C: usize>(frame: &Frame, output: Output) -> Plane<C> {
    let values = frame.planes[&output].as_chunks::<C>().0.to_vec();
    Plane { width: frame.width, height: frame.height, values }
}

/// A capture whose photographs and ground truth are renderings of `model`.
fn drawn_by(model: &Arc<Model>) -> Capture {
    let renderer = Renderer::new(model.clone());
    let lamp = EnvMap::from_fn(32, 16, |d| [0.4 + 0.5 * d.z.max(0.0) as f32, 0.5, 0.6]);
    let (own, lamp_light) =
        (renderer.prepare_light(model.recovered_light()).unwrap(), renderer.prepare_light(&lamp).unwrap());
    let layers = [
        Output::Rgb,
        Output::Albedo,
        Output::Normal,
        Output::Metallic,
        Output::Roughness,
        Output::Visibility,
        Output::Depth,
    ];
    let view = |i: usize| {
        let angle = i as f64;
        let eye = DVec3::new(3.0 * angle.cos(), 3.0 * angle.sin(), 1.5);
        let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.7, (SIDE, SIDE)).unwrap();
        let frame = renderer.render(&camera, &own, Tier::Standard, &layers).unwrap();
        let relit = renderer.render(&camera, &lamp_light, Tier::Standard, &[Output::Rgb]).unwrap();
        let (metal, rough) = (&frame.planes[&Output::Metallic], &frame.planes[&Output::Roughness]);
        let material = metal.iter().zip(rough).map(|(m, r)| [*m, *r]).collect();
        let truth = GroundTruthView {
            relit: [("lamp".to_owned(), straight(&relit, Output::Rgb))].into(),
            albedo: Some(plane(&frame, Output::Albedo)),
            normal: Some(plane(&frame, Output::Normal)),
            metallic_roughness: Some(Plane { width: SIDE, height: SIDE, values: material }),
            ambient_occlusion: Some(plane(&frame, Output::Visibility)),
            depth: Some(plane(&frame, Output::Depth)),
        };
        let image = PackedImage::new(&straight(&frame, Output::Rgb), BitDepth::Sixteen);
        CaptureView {
            name: format!("test_{i}"),
            camera,
            image,
            light_rotation_deg: 0.0,
            light_group: None,
            truth,
        }
    };
    Capture {
        layout: "synthetic".into(),
        train: Vec::new(),
        test: (0..3).map(view).collect(),
        points: Vec::new(),
        bounds: SceneBounds { centre: DVec3::ZERO, radius: 1.0 },
        has_alpha: true,
        lights: [("lamp".to_owned(), lamp)].into(),
        turntable: None,
        measured_light: None,
        grey_card: None,
        colour_chart: None,
        up: Default::default(),
        warnings: Vec::new(),
    }
}

fn measured(model: &Arc<Model>, capture: &Capture) -> Report {
    let options = EvalOptions { frame_rate_time: Duration::ZERO, ..EvalOptions::default() };
    evaluate(model.clone(), capture, &options).unwrap()
}

#[test]
fn a_model_scores_perfectly_on_its_own_renders() {
    let model = Arc::new(model());
    let report = measured(&model, &drawn_by(&model));
    assert!(report.novel_view.psnr.unwrap() > 80.0, "{:?}", report.novel_view);
    assert!(report.relit.mean.psnr.unwrap() > 80.0, "{:?}", report.relit);
    assert!(report.albedo.psnr_raw.unwrap() > 80.0, "{:?}", report.albedo);
    assert!(report.novel_view.ssim.unwrap() > 0.999_999);
    assert!(report.normal_mae_deg.foreground.unwrap() < 1e-3, "{:?}", report.normal_mae_deg);
    assert!(report.normal_mae_deg.all_pixels.unwrap() < 1e-3, "{:?}", report.normal_mae_deg);
    for error in [report.ao_mae, report.roughness_mae, report.metallic_mae, report.depth_mae] {
        assert!(error.unwrap() < 1e-6);
    }
    assert_eq!(report.training_seconds, Some(12.5));
    assert_eq!((report.views, report.gaussians), (3, 9));
    assert!(report.novel_view_foreground_psnr.unwrap() > 80.0, "{:?}", report.novel_view_foreground_psnr);
}

#[test]
fn views_without_a_pixel_of_the_object_are_not_compared() {
    let model = Arc::new(model());
    let mut capture = drawn_by(&model);
    let before = measured(&model, &capture);
    let pixels = |view: &CaptureView| view.image.pixels().filter(|p| p[3] > 0.5).count() as u64;
    assert_eq!(before.foreground_pixels, capture.test.iter().map(pixels).sum::<u64>());
    let all = 3.0 * f64::from(SIDE * SIDE);
    assert!((before.foreground_share.unwrap() - before.foreground_pixels as f64 / all).abs() < 1e-12);
    let empty = ImageRgba { width: SIDE, height: SIDE, pixels: vec![[0.0; 4]; (SIDE * SIDE) as usize] };
    capture.test[1].image = PackedImage::new(&empty, BitDepth::Eight);
    let dropped = pixels(&capture.test[0]) + pixels(&capture.test[2]);
    let after = measured(&model, &capture);
    assert_eq!((after.views, after.foreground_pixels), (2, dropped));
    capture.test.truncate(2);
    capture.test.remove(0);
    let options = EvalOptions { frame_rate_time: Duration::ZERO, ..EvalOptions::default() };
    let refused = evaluate(model, &capture, &options);
    assert!(matches!(refused, Err(EvalError::NoTestViews)), "an empty mask gives no score: {refused:?}");
}

#[test]
fn every_metric_responds_to_errors_in_its_own_ground_truth() {
    let model = Arc::new(model());
    let mut capture = drawn_by(&model);
    for view in &mut capture.test {
        let truth = &mut view.truth;
        let mut image = view.image.decoded();
        image.pixels.iter_mut().for_each(|p| p[0] = 1.0 - p[0]);
        view.image = PackedImage::new(&image, BitDepth::Sixteen);
        for image in truth.relit.values_mut() {
            image.pixels.iter_mut().for_each(|p| p[1] *= 0.5);
        }
        truth.albedo.as_mut().unwrap().values.iter_mut().flatten().for_each(|v| *v *= 0.5);
        truth.normal.as_mut().unwrap().values.iter_mut().for_each(|n| *n = [-n[0], -n[1], -n[2]]);
        let add = |plane: &mut Plane<1>| plane.values.iter_mut().for_each(|v| v[0] += 0.25);
        add(truth.ambient_occlusion.as_mut().unwrap());
        add(truth.depth.as_mut().unwrap());
        let material = truth.metallic_roughness.as_mut().unwrap();
        material.values.iter_mut().for_each(|v| *v = [v[0] + 0.125, v[1] + 0.5]);
    }
    let report = measured(&model, &capture);
    assert!(report.novel_view.psnr.unwrap() < 40.0 && report.novel_view.ssim.unwrap() < 0.999);
    assert!(report.relit.mean.psnr.unwrap() < 40.0);
    assert!(report.albedo.psnr_raw.unwrap() < 40.0);
    for scale in report.albedo.scale.unwrap() {
        assert!((scale - 0.5).abs() < 1e-3, "{:?}", report.albedo);
    }
    assert!((report.normal_mae_deg.foreground.unwrap() - 180.0).abs() < 1e-2);
    assert!(report.normal_mae_deg.all_pixels.unwrap() > 1.0);
    assert!((report.ao_mae.unwrap() - 0.25).abs() < 1e-5);
    assert!((report.depth_mae.unwrap() - 0.25).abs() < 1e-5);
    assert!((report.metallic_mae.unwrap() - 0.125).abs() < 1e-5);
    assert!((report.roughness_mae.unwrap() - 0.5).abs() < 1e-5);
}

#[test]
fn ground_truth_in_place_of_a_corrupted_layer_restores_psnr() {
    let model = Arc::new(model());
    let capture = drawn_by(&model);
    let mut dark = (*model).clone();
    dark.prototypes.iter_mut().flatten().for_each(|v| *v *= 0.6);
    use TruthLayer::{Albedo, Alpha, Material, Normal, Occlusion};
    let rows: [&[TruthLayer]; 4] =
        [&[], &[Albedo], &[Material], &[Albedo, Normal, Material, Occlusion, Alpha]];
    let [nothing, albedo, material, everything] =
        attribute(&Arc::new(dark), &capture, None, &rows).unwrap().try_into().unwrap();
    let [nothing, albedo, material, everything] = [nothing, albedo, material, everything].map(Option::unwrap);
    assert!(nothing < 35.0, "{nothing}");
    // Half-covered pixels keep the model's layers, and indirect light is gathered from the dark albedo.
    assert!(albedo > nothing + 10.0 && everything > nothing + 10.0, "{nothing} {albedo} {everything}");
    assert!((material - nothing).abs() < 1.0, "the control: what was not spoilt repairs nothing, {material}");
    // Without replacement the value equals that of the evaluation if surfaces are shaded in the pixel.
    let difference = |shade_at| {
        let shading = ShadingOptions { shade_at, ..model.shading };
        let model = Arc::new(Model { shading, ..(*model).clone() });
        let own = attribute(&model, &capture, None, &[&[]]).unwrap()[0];
        (own.unwrap() - measured(&model, &capture).relit.mean.psnr.unwrap()).abs()
    };
    assert!(difference(ShadeAt::Pixel) < 1e-6);
    assert!(difference(ShadeAt::Gaussian) > 1e-3, "the control");
    let mut ragged = drawn_by(&model);
    ragged.test[1].truth.albedo.as_mut().unwrap().values.pop();
    let err = attribute(&model, &ragged, None, &rows).unwrap_err();
    assert!(err.to_string().contains("test_1: albedo"), "{err}");
}

#[test]
fn unavailable_metrics_are_null_with_an_explaining_note() {
    let model = Arc::new(Model { card: serde_json::Value::Null, ..model() });
    let mut capture = drawn_by(&model);
    capture.lights.clear();
    capture.test.iter_mut().for_each(|view| view.truth.albedo = None);
    let report = measured(&model, &capture);
    let json: serde_json::Value = serde_json::from_str(&report.to_json()).unwrap();
    for (pointer, note) in [
        ("/relit/mean/psnr", "relit.lamp"),
        ("/albedo/psnr_raw", "albedo"),
        ("/novel_view/lpips", "novel_view.lpips"),
        ("/training_seconds", "training_seconds"),
    ] {
        assert!(json.pointer(pointer).unwrap().is_null(), "{pointer} is not null");
        assert!(report.notes.contains_key(note), "no note on {note}: {:?}", report.notes);
    }
    assert!(report.novel_view.psnr.is_some() && report.ao_mae.is_some());
    assert!(!report.notes.contains_key("ao_mae"));
}

#[test]
fn frame_rates_are_reported_for_every_tier() {
    let model = Arc::new(model());
    let options =
        EvalOptions { views: Some(1), frame_rate_time: Duration::from_millis(1), ..EvalOptions::default() };
    let report = evaluate(model.clone(), &drawn_by(&model), &options).unwrap();
    for tier in ["preview", "standard"] {
        assert!(report.render_fps[tier] > 0.0);
    }
}

#[test]
fn a_layer_of_wrong_size_is_refused_with_view_and_layer_name() {
    let model = Arc::new(model());
    let mut capture = drawn_by(&model);
    let albedo = capture.test[1].truth.albedo.as_mut().unwrap();
    *albedo = albedo.resized(20, 20);
    let refused = evaluate(model, &capture, &EvalOptions::default()).unwrap_err().to_string();
    assert!(
        refused.contains("test_1") && refused.contains("albedo") && refused.contains("20x20"),
        "{refused}"
    );
}

#[test]
fn a_capture_without_held_out_views_is_refused() {
    let model = Arc::new(model());
    let mut capture = drawn_by(&model);
    capture.test.clear();
    let refused = evaluate(model.clone(), &capture, &EvalOptions::default());
    assert_eq!(refused.unwrap_err(), EvalError::NoTestViews);
    let rows = SheetRows::choose(&capture, None);
    assert!(contact_sheet(model, &rows, Tier::Standard, &Device::Cpu).is_err());
}

#[test]
fn contact_sheet_is_an_image_with_a_row_per_view() {
    let model = Arc::new(model());
    let rows = SheetRows::choose(&drawn_by(&model), None);
    let sheet = contact_sheet(model, &rows, Tier::Standard, &Device::Cpu).unwrap();
    let image = image::load_from_memory(&sheet.encode(SheetFormat::Png).unwrap()).unwrap().into_rgb8();
    // 3 pictures, two lights, four layers; the ground truth of each view is below it.
    assert_eq!(image.width(), 8 + 9 * (CELL + 8));
    assert!(image.height() > 6 * CELL && image.height() < 7 * CELL);
}

#[test]
fn report_names_the_weakest_view() {
    let model = Arc::new(model());
    let mut capture = drawn_by(&model);
    let mut image = capture.test[1].image.decoded();
    image.pixels.iter_mut().for_each(|p| p[0] = 1.0 - p[0]);
    capture.test[1].image = PackedImage::new(&image, BitDepth::Sixteen);
    let report = measured(&model, &capture);
    let weakest = report.weakest_view.as_ref().unwrap();
    assert!(weakest.view == "test_1" && weakest.psnr < 40.0, "{weakest:?}");
    let rows = SheetRows::choose(&capture, Some(&report));
    let sheet = contact_sheet(model, &rows, Tier::Standard, &Device::Cpu).unwrap();
    assert!(sheet.encode(SheetFormat::Jpeg).is_ok());
}

fn arguments(model: PathBuf, capture: PathBuf, json: PathBuf) -> EvalArgs {
    EvalArgs {
        light_rotations: None,
        model,
        capture,
        json: Some(json),
        device: DeviceChoice::Cpu,
        quality: QualityArgs::default(),
        markdown: None,
        sheet: None,
        lpips: None,
        resolution: Some(48),
        views: Some(1),
    }
}

#[test]
fn eval_command_names_the_bad_file_and_checks_outputs_first() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    std::fs::write(file("model"), b"no model").unwrap();
    let refused = |args: EvalArgs| run(&args).unwrap_err().to_string();
    let unreadable = refused(arguments(file("absent"), file("scene"), file("out.json")));
    assert!(unreadable.contains("absent"), "{unreadable}");
    let no_model = refused(arguments(file("model"), file("scene"), file("out.json")));
    assert!(no_model.contains("model"), "{no_model}");
    // The inputs do not exist either: outputs are checked first.
    let unwritable = refused(arguments(file("absent"), file("scene"), file("model/out.json")));
    assert!(unwritable.contains("out.json"), "{unwritable}");
    let sheet = Some(file("sheet.gif"));
    let no_sheet = refused(EvalArgs { sheet, ..arguments(file("absent"), file("scene"), file("out.json")) });
    assert!(no_sheet.contains("sheet.gif") && no_sheet.contains(".png or .jpg"), "{no_sheet}");
    std::fs::write(file("model"), model_file::encode(&model()).unwrap()).unwrap();
    let no_capture = refused(arguments(file("model"), file("scene"), file("out.json")));
    assert!(no_capture.contains("scene"), "{no_capture}");
    assert!(!file("out.json").exists(), "a failed evaluation leaves no report behind");
}

/// Tests with LPIPS weights and a real scene.
mod with_data {
    use super::*;
    use relume_fixtures::data;

    fn picture(path: PathBuf) -> DisplayImage {
        let image = image::open(path).unwrap().into_rgb32f();
        let values = image.pixels().map(|p| p.0).collect();
        Plane { width: image.width(), height: image.height(), values }
    }

    #[test]
    #[ignore = "needs RELUME_TEST_DATA (see CONTRIBUTING.md)"]
    fn lpips_matches_the_published_values() {
        let folder = data("lpips");
        let lpips = Lpips::read(&folder.join("lpips_alex_v0.1.safetensors")).unwrap();
        let image = |name: &str| picture(folder.join("reference_images").join(name));
        let reference = image("ex_ref.png");
        for (other, published) in [("ex_p0.png", 0.722), ("ex_p1.png", 0.138)] {
            let distance = lpips.distance(&reference, &image(other)).unwrap();
            assert!((distance - published).abs() < 2e-3, "{other}: {distance}, published {published}");
        }
        assert_eq!(lpips.distance(&reference, &reference), Some(0.0));
        // Negative control: another range of inputs gives another distance.
        let mut dark = (reference.clone(), image("ex_p0.png"));
        dark.0.values.iter_mut().chain(&mut dark.1.values).flatten().for_each(|v| *v *= 0.5);
        assert!((lpips.distance(&dark.0, &dark.1).unwrap() - 0.722).abs() > 2e-3);
    }

    #[test]
    #[ignore = "needs RELUME_TEST_DATA (see CONTRIBUTING.md)"]
    fn lpips_is_absent_for_images_too_small_for_the_network() {
        let folder = data("lpips");
        let lpips = Lpips::read(&folder.join("lpips_alex_v0.1.safetensors")).unwrap();
        let flat =
            |side: u32| Plane { width: side, height: side, values: vec![[0.5; 3]; (side * side) as usize] };
        assert_eq!(lpips.distance(&flat(30), &flat(30)), None);
        assert_eq!(lpips.distance(&flat(31), &flat(31)), Some(0.0));
        assert_eq!(lpips.distance(&flat(31), &flat(32)), None);
    }

    #[test]
    #[ignore = "needs RELUME_TEST_DATA (see CONTRIBUTING.md)"]
    fn lpips_is_reported_when_weights_are_given() {
        let folder = data("lpips");
        let lpips = Lpips::read(&folder.join("lpips_alex_v0.1.safetensors")).unwrap();
        let model = Arc::new(model());
        let options = EvalOptions {
            lpips: Some(&lpips),
            views: Some(1),
            frame_rate_time: Duration::ZERO,
            ..EvalOptions::default()
        };
        let report = evaluate(model.clone(), &drawn_by(&model), &options).unwrap();
        assert!(report.novel_view.lpips.unwrap() < 1e-6 && report.relit.lights["lamp"].lpips.is_some());
        assert!(!report.notes.keys().any(|key| key.ends_with("lpips")), "{:?}", report.notes);
        assert_eq!(report.views, 1);
    }

    #[test]
    #[ignore = "needs RELUME_TEST_DATA (see CONTRIBUTING.md)"]
    fn eval_command_writes_json_markdown_and_contact_sheet() {
        let scene = data("scenes/helmet");
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| folder.path().join(name);
        std::fs::write(file("model"), model_file::encode(&model()).unwrap()).unwrap();
        let args = EvalArgs {
            markdown: Some(file("report.md")),
            sheet: Some(file("sheet.png")),
            ..arguments(file("model"), scene, file("report.json"))
        };
        run(&args).unwrap();
        let report: Report = serde_json::from_slice(&std::fs::read(file("report.json")).unwrap()).unwrap();
        let lights: Vec<&str> = report.relit.lights.keys().map(String::as_str).collect();
        assert_eq!(lights, ["bridge", "city", "interior", "night"]);
        assert!(report.relit.mean.psnr.unwrap().is_finite() && report.albedo.psnr_aligned.is_some());
        assert!(report.normal_mae_deg.foreground.unwrap() > report.normal_mae_deg.all_pixels.unwrap());
        assert!(report.protocol.contains("48x48"), "{}", report.protocol);
        assert!(std::fs::read_to_string(file("report.md")).unwrap().contains("relit, night"));
        assert!(image::open(file("sheet.png")).is_ok());
    }
}
