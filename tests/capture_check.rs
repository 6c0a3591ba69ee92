//! `relume capture check` of captures with poses: it finds what a training would find.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use relume_fixtures::small_set::{Files, colmap, nerfstudio};
use serde_json::json;
use tempfile::TempDir;

fn stored(files: &Files) -> TempDir {
    let folder = TempDir::new().unwrap();
    for (name, bytes) in files {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }
    folder
}

fn check(capture: &Path, options: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
    command.args(["capture", "check"]).arg(capture).args(options).output().unwrap()
}

fn told(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
fn check_of_a_sound_capture_succeeds_and_draws_its_cameras() {
    let capture = stored(&nerfstudio(|_| ()));
    let sheet = capture.path().join("cameras.svg");
    let output = check(capture.path(), &["--sheet", sheet.to_str().unwrap()]);
    let text = told(&output);
    assert!(output.status.success() && text.ends_with("\nsuitable for training\n"), "{text}");
    assert!(text.starts_with("nerfstudio: 5 photographs to train on, 1 held out, 8 x 6 pixels"), "{text}");
    let svg = fs::read_to_string(&sheet).unwrap();
    assert_eq!(svg.matches("<title>images/").count(), 2 * 6, "each camera in both panels");
}

#[test]
fn check_prints_what_a_training_would_refuse_or_warn_of() {
    let transposed = nerfstudio(|set| {
        let matrix = set["frames"][2]["transform_matrix"].clone();
        for i in 0..4 {
            (0..4).for_each(|k| set["frames"][2]["transform_matrix"][i][k] = matrix[k][i].clone());
        }
    });
    let output = check(stored(&transposed).path(), &[]);
    let text = told(&output);
    assert_eq!(output.status.code(), Some(1));
    assert!(text.contains("problem: transforms.json: frames[2].transform_matrix"), "{text}");
    assert!(text.ends_with("\nnot suitable for training\n"), "{text}");
    let missing = nerfstudio(|set| set["ply_file_path"] = json!("cloud.ply"));
    let output = check(stored(&missing).path(), &[]);
    let text = told(&output);
    assert!(
        output.status.success() && text.contains("warning: transforms.json names the point cloud"),
        "{text}"
    );
}

#[test]
fn check_states_the_up_axis_and_takes_another() {
    let y_up = nerfstudio(|set| {
        for frame in set["frames"].as_array_mut().unwrap() {
            let rows = frame["transform_matrix"].as_array().unwrap().clone();
            frame["transform_matrix"] = json!([rows[1], rows[2], rows[0], rows[3]]);
        }
    });
    let capture = stored(&y_up);
    let text = told(&check(capture.path(), &[]));
    assert!(text.contains("probably +Y is up: train with --up y"), "{text}");
    let text = told(&check(capture.path(), &["--up", "y"]));
    assert!(!text.contains("warning"), "{text}");
    let refused = check(capture.path(), &["--up", "north"]);
    assert_eq!(refused.status.code(), Some(2));
    let picture = check(capture.path(), &["--sheet", "cameras.png"]);
    assert_eq!(picture.status.code(), Some(2), "a picture of another kind");
}

#[test]
fn evidence_for_the_up_direction_is_a_note_and_no_hint() {
    let text = told(&check(stored(&colmap()).path(), &[]));
    assert!(text.contains("\nnote: up: "), "{text}");
    assert!(!text.contains("hint: up"), "{text}");
    assert!(text.contains("\nhint: "), "the control, photographs of 8 x 6 pixels are small: {text}");
}

#[test]
fn training_on_an_empty_folder_says_what_to_put_there() {
    let empty = TempDir::new().unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
    let output = command.args(["train", "--device", "cpu"]).arg(empty.path()).output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && text.contains("put at least 3 photographs into it"), "{text}");
    assert!(!text.contains("`relume train`"), "{text}");
}
