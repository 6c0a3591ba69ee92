//! Commands that work without a server, as processes.

use std::path::Path;
use std::process::{Command, Output};

use relume_capture::formats::{image_file, model_file};
use relume_capture::{ImportLimits, ImportOptions, inspect};
use relume_engine::Device;
use relume_spec::training::{Preset, TrainConfig, TrainOverrides};
use relume_train::{MemoryBudget, Trainer, import_for_training};

use tempfile::TempDir;

use crate::service_support::capture_zip;

fn relume(folder: &Path, args: &[&str]) -> Output {
    let output = Command::new(env!("CARGO_BIN_EXE_relume")).args(args).current_dir(folder).output();
    output.unwrap()
}

fn succeeds(folder: &Path, args: &[&str]) -> String {
    let output = relume(folder, args);
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn fails_with(folder: &Path, args: &[&str], word: &str) {
    let output = relume(folder, args);
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && message.contains(word), "{args:?}: {message}");
}

/// Checks that a training ends with three lines: scores of held-out photographs, the weakest view, causes.
fn ends_with_scores(said: &str) {
    let lines: Vec<&str> = said.lines().rev().take(3).collect();
    let starts = ["causes: ", "weakest: ", "held-out photographs ("];
    assert!(lines.iter().zip(starts).all(|(line, start)| line.starts_with(start)), "{said}");
    assert!(lines[2].contains(" dB") && !lines[2].contains("PSNR -"), "{said}");
}

#[test]
fn cli_trains_renders_and_exports_a_capture() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    std::fs::write(at.join("scan.zip"), capture_zip()).unwrap();
    let train =
        ["train", "scan.zip", "--preset", "draft", "--resolution", "32", "--seed", "3", "--device", "cpu"];
    // Twelve steps show no need for any part of the model.
    let more = "--set iterations=12 --set max_gaussians=64 --set complexity=full --out m.safetensors";
    let more: Vec<&str> = more.split(" ").collect();
    let output = relume(at, &[&train[..], &more].concat());
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    ends_with_scores(&said);
    let sheet = image_file::dimensions(&std::fs::read(at.join("m.sheet.png")).unwrap()).unwrap();
    assert!(sheet.0 > 9 * 320 && sheet.1 > 320, "{sheet:?}");
    let model = model_file::decode(&std::fs::read(at.join("m.safetensors")).unwrap()).unwrap();
    assert_eq!((&model.card["steps"], &model.card["config"]["seed"]), (&12.into(), &3.into()));
    for (file, env) in [("a.png", "studio"), ("b.exr", "recovered"), ("c.jpg", "night")] {
        succeeds(
            at,
            &["render", "m.safetensors", "--env", env, "--size", "24", "--azimuth", "-30", "--out", file],
        );
        assert_eq!(
            image_file::dimensions(&std::fs::read(at.join(file)).unwrap()).unwrap(),
            (24, 24),
            "{file}"
        );
    }
    succeeds(at, &["export", "m.safetensors", "--out", "m.ply"]);
    assert!(std::fs::read(at.join("m.ply")).unwrap().starts_with(b"ply\n"));

    fails_with(at, &["render", "m.safetensors", "--env", "mars", "--out", "d.png"], "mars");
    fails_with(at, &["render", "m.safetensors", "--out", "d.gif"], "d.gif");
    fails_with(at, &["render", "m.safetensors", "--output", "colour", "--out", "d.png"], "colour");
    fails_with(at, &["export", "m.safetensors", "--out", "m.obj"], "m.obj");
    fails_with(at, &["export", "scan.zip"], "model file");
    fails_with(at, &["train", "scan.zip", "--set", "speed=11"], "speed");
    fails_with(at, &["train", "scan.zip", "--set", "iterations=0"], "iterations");
    fails_with(at, &["train", "nowhere.zip"], "nowhere.zip");
    fails_with(at, &["train", "scan.zip", "--light", "mars.hdr"], "mars.hdr");
    fails_with(
        at,
        &["train", "scan.zip", "--light", "studio", "--light-exposure", "40"],
        "light.exposure_ev",
    );
    fails_with(at, &["train", "scan.zip", "--light", "studio", "--light-exposure", "dim"], "dim");
    fails_with(at, &["train", "scan.zip", "--light-exposure", "1"], "--light");
    let left = ["d.png", "d.gif", "m.obj", "model.ply", "model.safetensors"].map(|f| at.join(f).exists());
    assert_eq!(left, [false; 5], "a refusal leaves nothing behind");
}

#[test]
fn sample_is_a_small_reproducible_capture_with_held_out_views() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    succeeds(at, &["sample"]);
    succeeds(at, &["sample", "again.zip"]);
    succeeds(at, &["sample", "other.zip", "--seed", "1"]);
    let bytes = |file: &str| std::fs::read(at.join(file)).unwrap();
    assert!(bytes("capture.zip") == bytes("again.zip"), "the same bytes each time");
    assert!(bytes("capture.zip") != bytes("other.zip") && bytes("capture.zip").len() < 2 << 20);
    let report = inspect(&at.join("capture.zip"), &ImportOptions::default()).unwrap();
    assert_eq!((report.train_images, report.test_images, report.warnings.len()), (20, 4, 0));
    fails_with(at, &["sample", "capture.zip/inside.zip"], "capture.zip/inside.zip");
}

#[test]
fn a_light_with_implausible_exposure_gives_a_warning() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    std::fs::write(at.join("scan.zip"), capture_zip()).unwrap();
    let says = |exposure: &str| {
        let args = ["train", "scan.zip", "--preset", "draft", "--resolution", "32", "--iterations", "2"];
        let light = ["--set", "max_gaussians=64", "--light", "studio", "--light-exposure", exposure];
        let output =
            relume(at, &[&args, &light[..], &["--device", "cpu", "--no-sheet", "--out", "m"]].concat());
        assert!(output.status.success() && !at.join("m.sheet.png").exists());
        String::from_utf8_lossy(&output.stderr).contains("stops from its usual level in photographs")
    };
    assert_eq!(["auto", "0", "3", "-4"].map(says), [false, false, true, true]);
}

#[test]
fn cli_training_resumes_from_its_checkpoint_and_removes_it() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    std::fs::write(at.join("scan.zip"), capture_zip()).unwrap();
    let train = |out: &str, more: &[&str]| {
        let args = ["train", "scan.zip", "--preset", "draft", "--resolution", "32", "--iterations", "12"];
        let set =
            ["--device", "cpu", "--set", "max_gaussians=64", "--set", "checkpoint_every=5", "--out", out];
        relume(at, &[&args, &set[..], &["--no-sheet"], more].concat())
    };
    assert!(train("whole.safetensors", &[]).status.success());

    let overrides = TrainOverrides {
        resolution: Some(32),
        iterations: Some(12),
        max_gaussians: Some(64),
        checkpoint_every: Some(5),
        ..TrainOverrides::default()
    };
    let config = TrainConfig::new(Preset::Draft, &overrides).unwrap();
    let capture = import_for_training(
        &at.join("scan.zip"),
        &config,
        &ImportLimits::default(),
        MemoryBudget::unbounded(),
    )
    .unwrap();
    let mut trainer = Trainer::new(&capture, config, &Device::Cpu).unwrap();
    (0..7).for_each(|_| {
        trainer.step().unwrap();
    });
    std::fs::write(at.join("c"), trainer.checkpoint().unwrap()).unwrap();
    let output = train("resumed.safetensors", &["--checkpoint", "c"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && said.contains("resuming from step 7"), "{said}");
    let model = |file: &str| model_file::decode(&std::fs::read(at.join(file)).unwrap()).unwrap();
    assert!(model("whole.safetensors").gaussians == model("resumed.safetensors").gaussians);
    assert!(!at.join("c").exists(), "the checkpoint of a finished training");

    let output = train("third.safetensors", &["--checkpoint", "."]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && said.contains("--checkpoint .: is a folder"), "{said}");

    std::fs::write(at.join("c"), b"something else").unwrap();
    let output = train("third.safetensors", &["--checkpoint", "c"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && said.contains("c: checkpoint"), "{said}");
    assert!(at.join("c").exists() && !at.join("third.safetensors").exists(), "what is not ours stays");
}

#[test]
fn doctor_reports_the_machine_and_openapi_the_description() {
    let folder = TempDir::new().unwrap();
    let report = succeeds(folder.path(), &["doctor"]);
    for line in ["cpu threads", "cpu features", "database      SQLite", "data dir"] {
        assert!(report.contains(line), "{report}");
    }
    assert!(!folder.path().join("relume-data").exists(), "looking makes nothing");
    let description: serde_json::Value =
        serde_json::from_str(&succeeds(folder.path(), &["openapi"])).unwrap();
    assert_eq!(description, serde_json::to_value(relume::server::openapi()).unwrap());
}

#[test]
fn serve_refuses_open_network_access_and_weak_keys() {
    let folder = TempDir::new().unwrap();
    fails_with(folder.path(), &["serve", "--listen", "0.0.0.0:0"], "API key");
    fails_with(folder.path(), &["serve", "--listen", "0.0.0.0:0", "--api-key", "short"], "16 characters");
    let serve = ["serve", "--listen", "127.0.0.1:0"];
    fails_with(folder.path(), &[&serve[..], &["--cors-origin", "*"]].concat(), "API key");
    fails_with(folder.path(), &[&serve[..], &["--cors-origin", "app.example"]].concat(), "is not an origin");
    fails_with(folder.path(), &[&serve[..], &["--head-timeout", "0"]].concat(), "--head-timeout");
    fails_with(folder.path(), &[&serve[..], &["--max-disk", "5GB"]].concat(), "--max-disk");
    fails_with(folder.path(), &[&serve[..], &["--keep-jobs", "never"]].concat(), "--keep-jobs");
    assert!(!folder.path().join("relume-data").join("relume.db").exists());
}

#[test]
fn train_checks_before_it_trains_that_its_files_can_be_written() {
    let folder = TempDir::new().unwrap();
    std::fs::write(folder.path().join("file"), "x").unwrap();
    // No capture exists, so a check after the import would name the capture.
    for (option, path) in [("--out", "file/model.safetensors"), ("--checkpoint", "file/x"), ("--out", ".")] {
        fails_with(folder.path(), &["train", "none", option, path], option);
    }
    fails_with(folder.path(), &["train", "none", "--out", "new/folder/model.safetensors"], "none");
    let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left, ["file"], "the check creates nothing");
}

#[test]
fn worker_refuses_a_server_address_that_is_not_http() {
    let folder = TempDir::new().unwrap();
    for address in ["file:///", "ftp://example.org", "localhost:7878"] {
        fails_with(folder.path(), &["worker", "--server", address, "--device", "cpu"], "http://");
    }
}
