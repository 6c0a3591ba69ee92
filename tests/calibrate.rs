//! `relume calibrate`: a patch of known reflectance determines the albedo of a model.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use relume_capture::{SyntheticOptions, synthetic, write_archive};
use tempfile::TempDir;

fn relume(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
    command.current_dir(folder).args(arguments).output().unwrap()
}

fn told(output: &Output) -> String {
    String::from_utf8_lossy(&[output.stdout.as_slice(), &output.stderr].concat()).into_owned()
}

/// Calibrates `model` by a rectangle in the middle of the first photograph.
fn calibrate(folder: &Path, model: &str, patch: &str, out: &str) -> Output {
    let patch = ["--patch", patch, "--reflectance", "0.3,0.2,0.1"];
    let files = ["calibrate", model, "--capture", "capture.zip", "--out", out, "--device", "cpu"];
    relume(folder, &[&files[..], &patch].concat())
}

/// A folder with a small capture and a model of it after `steps` steps.
fn trained(steps: &[&str]) -> TempDir {
    let folder = TempDir::new().unwrap();
    let options =
        SyntheticOptions { size: 32, train_views: 6, test_views: 1, paths: 4, ..Default::default() };
    let archive = write_archive(&synthetic(&options).unwrap()).unwrap();
    fs::write(folder.path().join("capture.zip"), archive).unwrap();
    let model = ["train", "capture.zip", "--preset", "draft", "--out", "a.safetensors"];
    let options = ["--resolution", "32", "--device", "cpu", "--no-sheet"];
    let output = relume(folder.path(), &[&model[..], &options, steps].concat());
    assert!(output.status.success(), "{}", told(&output));
    folder
}

#[test]
fn calibrated_model_has_the_reflectance_of_the_patch() {
    let folder = trained(&["--iterations", "60"]);
    let at = folder.path();
    let middle = "train_000/rgba.png:14,14,4,4";
    let first = told(&calibrate(at, "a.safetensors", middle, "b.safetensors"));
    assert!(first.contains("is 0.300, 0.200, 0.100"), "{first}");
    assert!(!first.contains("divided by 1.000"), "the control: {first}");
    let again = told(&calibrate(at, "b.safetensors", middle, "c.safetensors"));
    assert!(again.contains("the light was divided by 1.000, 1.000, 1.000"), "{again}");
    let explained = told(&relume(at, &["explain", "b.safetensors"]));
    assert!(explained.contains("for a surface of reflectance 0.30, 0.20, 0.10"), "{explained}");
}

#[test]
fn patches_that_determine_nothing_are_refused_by_name() {
    let folder = trained(&["--iterations", "2", "--warm-up", "0"]);
    let at = folder.path();
    for (patch, reason) in [
        ("train_000/rgba.png:30,0,4,4", "patch.width"),
        ("missing.png:0,0,4,4", "patch.photo"),
        ("train_000/rgba.png:0,0,2,2", "the model covers"),
    ] {
        let refused = calibrate(at, "a.safetensors", patch, "b.safetensors");
        assert_eq!(refused.status.code(), Some(1), "{patch}: {}", told(&refused));
        assert!(told(&refused).contains(reason), "{patch}: {}", told(&refused));
        assert!(!at.join("b.safetensors").exists(), "{patch}");
    }
}
