//! Frame sequences on the command line.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::{Value, json};
use tempfile::TempDir;

use crate::service_support::capture_zip;

fn relume(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_relume")).args(args).current_dir(folder).output().unwrap()
}

pub fn succeeds(folder: &Path, args: &[&str]) -> String {
    let output = relume(folder, args);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{args:?}: {said}");
    said
}

pub fn fails_with(folder: &Path, args: &[&str], word: &str) {
    let output = relume(folder, args);
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && message.contains(word), "{args:?}: {message}");
}

/// A folder with `m.safetensors`, a model of a few steps.
pub fn with_model() -> TempDir {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("scan.zip"), capture_zip()).unwrap();
    let train = ["train", "scan.zip", "--preset", "draft", "--resolution", "32", "--device", "cpu"];
    let more =
        ["--set", "iterations=12", "--set", "max_gaussians=64", "--no-sheet", "--out", "m.safetensors"];
    succeeds(folder.path(), &[&train[..], &more].concat());
    folder
}

pub fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name()).collect();
    names.sort();
    names.into_iter().map(|name| name.into_string().unwrap()).collect()
}

#[test]
fn render_starts_at_the_first_photograph_and_can_warn() {
    let folder = with_model();
    let at = folder.path();
    let light = ["render", "m.safetensors", "--env", "studio", "--device", "cpu", "--size", "24"];
    let made = |more: &[&str]| {
        let said = succeeds(at, &[&light[..], more, &["--out", "one.png"]].concat());
        (fs::read(at.join("one.png")).unwrap(), said)
    };
    let (default, said) = made(&[]);
    assert!(!said.contains("nearest photograph"), "{said}");
    assert!(made(&["--azimuth", "0"]).0 == default, "azimuth 0 is the first photograph");
    assert!(made(&["--azimuth", "90"]).0 != default, "the control");
    let (_, said) = made(&["--elevation", "-80"]);
    assert!(said.contains("warning: this view is") && said.contains("the nearest photograph ("), "{said}");
    let turntable = ["--turntable", "4", "--elevation", "-80", "--out", "f/%d.png"];
    let said = succeeds(at, &[&light[..], &turntable].concat());
    assert!(said.contains("warning: 4 of 4 views are more than 20 degrees"), "{said}");
}

#[test]
fn turntable_frames_equal_single_renders_and_can_be_resumed() {
    let folder = with_model();
    let at = folder.path();
    let light = ["render", "m.safetensors", "--env", "studio", "--device", "cpu", "--size", "24"];
    let turn = ["--turntable", "4", "--env-turn", "360", "--azimuth", "10", "--rotation", "5"];
    let turntable = [&light[..], &turn, &["--start-number", "1001", "--out", "f/%05d.exr"]].concat();
    succeeds(at, &turntable);
    let frames = at.join("f");
    let files = ["01001.exr", "01002.exr", "01003.exr", "01004.exr"];
    assert_eq!(names(&frames), files, "and nothing else");
    let read = |name: &str| fs::read(frames.join(name)).unwrap();
    let whole = files.map(read);

    for (i, azimuth, rotation) in [(0, "10", "5"), (1, "100", "95"), (3, "280", "275")] {
        let one = ["--azimuth", azimuth, "--rotation", rotation, "--out", "one.exr"];
        succeeds(at, &[&light[..], &one].concat());
        assert!(fs::read(at.join("one.exr")).unwrap() == whole[i], "frame {i}");
    }
    assert!(whole[0] != whole[1], "the control");

    fs::remove_file(frames.join(files[2])).unwrap();
    fs::write(frames.join(files[1]), "made earlier").unwrap();
    let said = succeeds(at, &[&turntable[..], &["--resume"]].concat());
    assert!(said.contains("frames written: 1, existed already: 3"), "{said}");
    assert!(read(files[2]) == whole[2], "the missing frame is made");
    assert_eq!(read(files[1]), b"made earlier", "what was there stays");
    succeeds(at, &turntable);
    assert!(files.map(read) == whole, "without --resume all are made");

    // As in a render farm: each task renders some frames, by their numbers.
    fs::remove_dir_all(&frames).unwrap();
    succeeds(at, &[&turntable[..], &["--frame", "1003"]].concat());
    assert_eq!(names(&frames), files[2..3]);
    succeeds(at, &[&turntable[..], &["--frames", "1001-1004:3,1002"]].concat());
    assert!(files.map(read) == whole, "frames of a task are those of the sequence");
    fails_with(at, &[&turntable[..], &["--frames", "1005"]].concat(), "the frames are 1001 to 1004");
    fails_with(at, &[&turntable[..], &["--frames", "4-1"]].concat(), "1-10");
}

#[test]
fn paths_of_nerfstudio_are_rendered_and_transposed_ones_refused() {
    let folder = with_model();
    let at = folder.path();
    let rows = [[0.0, 0.0, 1.0, 3.0], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    let columns: Vec<f64> = (0..16).map(|i| rows[i % 4][i / 4]).collect();
    let look = json!({ "look_at": { "eye": [3, 0, 0], "target": [0, 0, 0], "fov_y_deg": 40 } });
    let path = |matrix: Value| {
        let entry = json!({ "camera_to_world": matrix, "fov": 40.0, "aspect": 2.0 });
        json!({ "camera_type": "perspective", "render_height": 16.0, "render_width": 32.0, "camera_path": [entry] })
    };
    let render = ["render", "m.safetensors", "--device", "cpu", "--path"];
    let picture = |name: &str, file: Value| {
        fs::write(at.join(format!("{name}.json")), file.to_string()).unwrap();
        let (input, frames) = (format!("{name}.json"), format!("{name}/%d.png"));
        succeeds(at, &[&render[..], &[input.as_str(), "--out", frames.as_str()]].concat());
        fs::read(at.join(name).join("1.png")).unwrap()
    };
    let flat: Vec<f64> = rows.into_iter().flatten().collect();
    let wanted = picture("own", json!({ "width": 32, "height": 16, "cameras": [{ "camera": look }] }));
    assert!(picture("flat", path(json!(flat))) == wanted);
    assert!(picture("nested", path(json!(rows))) == wanted);
    let mut nearer = rows;
    nearer[0][3] = 2.0;
    assert!(picture("nearer", path(json!(nearer))) != wanted, "the control");

    fs::write(at.join("columns.json"), path(json!(columns)).to_string()).unwrap();
    let columns = [&render[..], &["columns.json", "--out", "n/%d.png"]].concat();
    let said = "columns.json: camera_path[0].camera_to_world: the last row must be 0 0 0 1, got 3 0 0 1; the matrix looks transposed";
    fails_with(at, &columns, said);
    assert!(!at.join("n").exists());
}

#[test]
fn camera_files_are_rendered_and_invalid_ones_refused_first() {
    let folder = with_model();
    let at = folder.path();
    let look = |x: f64| json!({ "camera": { "look_at": { "eye": [x, 1, 1], "target": [0, 0, 0], "fov_y_deg": 40 } } });
    let file = json!({ "width": 32, "height": 16, "cameras": [look(3.0), look(-3.0)] });
    fs::write(at.join("cameras.json"), file.to_string()).unwrap();
    fs::write(at.join("none.json"), "{\"cameras\": [{\"camera\": {}}]}").unwrap();
    let render = ["render", "m.safetensors", "--device", "cpu"];
    let path = [&render[..], &["--path", "cameras.json"]].concat();
    succeeds(at, &[&path[..], &["--resolution", "64x32", "--out", "g/%d.png"]].concat());
    assert_eq!(names(&at.join("g")), ["1.png", "2.png"]);
    let picture = |name: &str| {
        relume_capture::formats::image_file::decode(&fs::read(at.join("g").join(name)).unwrap(), 1 << 20)
            .unwrap()
    };
    assert_eq!((picture("1.png").width, picture("1.png").height), (64, 32));
    assert_ne!(picture("1.png"), picture("2.png"));

    let out = ["--out", "n/%d.png"];
    for (more, word) in [
        (&["--out", "n.png"][..], "%04d"),
        (&["--turntable", "3", "--out", "n/%d.png"], "--turntable"),
        (&["--resolution", "64x64", "--out", "n/%d.png"], "aspect ratio"),
        (&["--alpha", "straight", "--out", "n/%d.png"], "alpha"),
        (&["--primaries", "acescg", "--out", "n/%d.jpg"], "primaries"),
    ] {
        fails_with(at, &[&path[..], more].concat(), word);
    }
    fails_with(at, &[&render[..], &["--path", "none.json"], &out].concat(), "none.json: cameras[0].camera");
    fails_with(at, &[&render[..], &["--path", "absent.json"], &out].concat(), "absent.json");
    fails_with(at, &[&render[..], &["--path", "."], &out].concat(), "COLMAP model");
    fails_with(at, &[&render[..], &["--env-turn", "90", "--out", "n.png"]].concat(), "--env-turn");
    fails_with(at, &[&render[..], &["--resume", "--out", "n.png"]].concat(), "--resume");
    fails_with(at, &[&render[..], &["--frames", "1", "--out", "n.png"]].concat(), "--frames");
    assert!(!at.join("n").exists() && !at.join("n.png").exists(), "a refusal leaves nothing behind");
}
