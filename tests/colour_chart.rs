//! `--colour-chart` of `relume train` and `--chart` of `relume calibrate`.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use relume_capture::formats::model_file;
use relume_capture::{Capture, ImportLimits, SyntheticOptions, synthetic, write_archive};
use relume_compare::largest_difference;
use relume_fixtures::colour_chart::SRGB;
use relume_scene::{BitDepth, DisplayRange, ImageRgba, PackedImage, srgb};
use relume_spec::training::{ChartEdition, ColourChart, Preset, TrainConfig, TrainOverrides};
use relume_train::{MemoryBudget, import_for_training};
use serde_json::Value;
use tempfile::TempDir;

/// Channels of white in the photographs.
const CAST: [f32; 3] = [0.9, 0.6, 0.4];
/// The chart in the photograph: its left and upper edge, and the size of a patch, pixels. The patches have no distance.
const LEFT: usize = 14;
const TOP: usize = 20;
const SIDE: usize = 6;

fn relume(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
    command.current_dir(folder).args(arguments).output().unwrap()
}

fn told(output: &Output) -> String {
    String::from_utf8_lossy(&[output.stdout.as_slice(), &output.stderr].concat()).into_owned()
}

/// A folder with a small capture whose first photograph shows a chart in the middle, in a light with a colour cast.
fn capture() -> TempDir {
    let folder = TempDir::new().unwrap();
    let options =
        SyntheticOptions { size: 64, train_views: 6, test_views: 1, paths: 4, ..Default::default() };
    let mut capture = synthetic(&options).unwrap();
    let mut image = capture.train[0].image.decoded();
    for (index, patch) in SRGB.iter().enumerate() {
        let [r, g, b] =
            std::array::from_fn(|c| srgb::encode(srgb::decode(f32::from(patch[c]) / 255.0) * CAST[c]));
        let (x, y) = (LEFT + SIDE * (index % 6), TOP + SIDE * (index / 6));
        for (x, y) in (y..y + SIDE).flat_map(|y| (x..x + SIDE).map(move |x| (x, y))) {
            image.pixels[y * 64 + x] = [r, g, b, 1.0];
        }
    }
    capture.train[0].image = PackedImage::new(&image, BitDepth::Sixteen);
    fs::write(folder.path().join("capture.zip"), write_archive(&capture).unwrap()).unwrap();
    folder
}

/// The chart in `train_000/rgba.png` as an option, from corner `first`.
fn chart(first: usize) -> String {
    let (right, bottom) = (LEFT + 6 * SIDE, TOP + 4 * SIDE);
    let mut corners = [[LEFT, TOP], [right, TOP], [right, bottom], [LEFT, bottom]];
    corners.rotate_left(first);
    let numbers = corners.as_flattened().iter().map(usize::to_string).collect::<Vec<_>>().join(",");
    format!("train_000/rgba.png:{numbers}")
}

fn train(folder: &Path, out: &str, options: &[&str]) -> Output {
    let small =
        ["--preset", "draft", "--resolution", "32", "--iterations", "40", "--device", "cpu", "--no-sheet"];
    relume(folder, &[&["train", "capture.zip", "--out", out], &small[..], options].concat())
}

fn card(folder: &Path, model: &str) -> Value {
    model_file::decode(&fs::read(folder.join(model)).unwrap()).unwrap().card
}

#[test]
fn colour_chart_corrects_a_training_and_the_card_says_so() {
    let folder = capture();
    let at = folder.path();
    let edition = ["--chart-edition", "before_november_2014"];
    let trained = train(at, "a.safetensors", &[&["--colour-chart", &chart(0)], &edition[..]].concat());
    assert!(trained.status.success(), "{}", told(&trained));
    let found = card(at, "a.safetensors");
    let matrix: Vec<f64> = (0..3).filter_map(|i| found["colour_chart"]["matrix"][i][i].as_f64()).collect();
    // The published 8-bit colours are not exactly those of the reference.
    for (c, wanted) in [1.0, 1.5, 2.25].into_iter().enumerate() {
        assert!((matrix[c] / wanted - 1.0).abs() < 0.1, "{matrix:?}");
    }
    let mean = |name: &str| found["colour_chart"]["delta_e_2000"][name]["mean"].as_f64().unwrap();
    assert!(mean("before") > 10.0 && mean("after") < 2.5, "{found}");
    assert_eq!(found["config"]["white_balance"], "neutral");
    assert!(
        found["calibration"]["chart"]["neutral_patches"].as_u64().unwrap() > 0,
        "{}",
        found["calibration"]
    );
    let explained = told(&relume(at, &["explain", "a.safetensors"]));
    assert!(explained.contains("corrected with the colour chart in train_000/rgba.png"), "{explained}");
    assert!(explained.contains("neutral patches of the colour chart"), "{explained}");
    let compared = relume(at, &["eval", "a.safetensors", "--capture", "capture.zip", "--device", "cpu"]);
    assert!(compared.status.success(), "{}", told(&compared));

    let plain = train(at, "b.safetensors", &[]);
    assert!(plain.status.success(), "{}", told(&plain));
    assert!(card(at, "b.safetensors")["colour_chart"].is_null(), "the control");
    assert!(!told(&relume(at, &["explain", "b.safetensors"])).contains("colour chart"), "the control");
    calibrated_by_the_chart(at, &edition);
}

/// Calibrates the model `b.safetensors`, which was trained without the chart, twice.
fn calibrated_by_the_chart(at: &Path, edition: &[&str]) {
    let calibrate = |model: &str, corners: &str, out: &str| {
        let files = ["calibrate", model, "--capture", "capture.zip", "--chart", corners, "--out", out];
        told(&relume(at, &[&files[..], &["--device", "cpu"], edition].concat()))
    };
    let first = calibrate("b.safetensors", &chart(0), "c.safetensors");
    assert!(first.contains("patches of the chart") && first.contains("CIEDE2000"), "{first}");
    assert!(!first.contains("divided by 1.000, 1.000, 1.000"), "the control: {first}");
    let again = calibrate("c.safetensors", &chart(2), "d.safetensors");
    assert!(again.contains("divided by 1.000, 1.000, 1.000"), "{again}");
    assert!(again.contains("in the order 3, 4, 1, 2"), "a turned chart is recognised: {again}");
    let refused = calibrate("b.safetensors", "train_000/rgba.png:2,2,20,2,20,14,2,14", "e.safetensors");
    assert!(refused.contains("colour_chart.corners") && !at.join("e.safetensors").exists(), "{refused}");
}

#[test]
fn colour_chart_corrects_held_out_photographs_as_well() {
    let folder = capture();
    let path = folder.path().join("capture.zip");
    let chart = ColourChart { edition: ChartEdition::BeforeNovember2014, ..chart(0).parse().unwrap() };
    let limits = ImportLimits::default();
    let imported = |colour_chart: Option<ColourChart>| {
        let overrides = TrainOverrides { colour_chart, resolution: Some(64), ..Default::default() };
        let config = TrainConfig::new(Preset::Draft, &overrides).unwrap();
        import_for_training(&path, &config, &limits, MemoryBudget::unbounded()).unwrap()
    };
    let (plain, corrected) = (imported(None), imported(Some(chart)));
    let matrix = corrected.colour_chart.as_ref().unwrap().matrix;
    let views = |capture: &Capture| capture.train.iter().chain(&capture.test).cloned().collect::<Vec<_>>();
    let mut changed = 0;
    for (before, after) in views(&plain).iter().zip(&views(&corrected)) {
        assert_eq!((&before.name, before.camera), (&after.name, after.camera));
        let mut wanted = before.image.decoded();
        let off = |wanted: &ImageRgba| {
            largest_difference(after.image.decoded().pixels.as_flattened(), wanted.pixels.as_flattened())
        };
        changed += usize::from(off(&wanted) > 0.02);
        matrix.apply_to_image(&mut wanted, DisplayRange::Unit);
        // The photographs have 8 bits.
        assert!(off(&wanted) < 0.51 / 255.0, "{}: {}", before.name, off(&wanted));
    }
    assert_eq!((changed, plain.test.len()), (7, 1), "the control: all photographs were changed");
}

#[test]
fn colour_charts_that_cannot_be_used_are_refused_by_field() {
    let folder = capture();
    for (chart, says) in [
        ("train_009/rgba.png:14,20,50,20,50,44,14,44", "colour_chart.photo"),
        ("rgba.png:14,20,50,20,50,44,14,44", "several photographs"),
        ("train_000/rgba.png:14,20,90,20,90,44,14,44", "within the photograph of 64 x 64"),
        ("train_001/rgba.png:14,20,50,20,50,44,14,44", "colour_chart.corners"),
        ("train_000/rgba.png:14,20,50,44,50,20,14,44", "convex"),
    ] {
        let refused = train(folder.path(), "a.safetensors", &["--colour-chart", chart]);
        assert!(!refused.status.success() && told(&refused).contains(says), "{chart}: {}", told(&refused));
        assert!(!folder.path().join("a.safetensors").exists(), "{chart}");
    }
}
