//! Confidence of a model, places for further photographs, photographs without their light, and exports with a limit, from the command line.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use relume_capture::formats::{image_file, splat_import};
use relume_capture::{SyntheticOptions, synthetic, write_archive};
use tempfile::TempDir;

fn relume(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_relume")).current_dir(folder).args(arguments).output().unwrap()
}

/// Runs a command that must succeed. Returns its standard output and error.
fn done(folder: &Path, arguments: &[&str]) -> [String; 2] {
    let output = relume(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned())
}

/// The error of a command that must fail.
fn refused(folder: &Path, arguments: &[&str]) -> String {
    let output = relume(folder, arguments);
    assert!(!output.status.success(), "{arguments:?}");
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A folder with a capture and a model of it.
fn trained() -> TempDir {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let options =
        SyntheticOptions { size: 32, train_views: 6, test_views: 1, paths: 4, ..Default::default() };
    fs::write(at.join("capture.zip"), write_archive(&synthetic(&options).unwrap()).unwrap()).unwrap();
    let train = ["train", "capture.zip", "--preset", "draft", "--iterations", "60"];
    let out = ["--resolution", "32", "--device", "cpu", "--no-sheet", "--out", "a.safetensors"];
    done(at, &[&train[..], &out].concat());
    folder
}

/// Display values and alpha of a picture.
fn picture(file: &Path) -> Vec<[f32; 4]> {
    image_file::decode(&fs::read(file).unwrap(), 1 << 20).unwrap().pixels
}

#[test]
fn trained_models_have_confidence_and_imported_ones_do_not() {
    let folder = trained();
    let at = folder.path();
    let render = ["render", "--size", "48", "--device", "cpu", "--output", "confidence", "--out", "c.png"];
    done(at, &[&render[..], &["a.safetensors"]].concat());
    let levels: Vec<f32> = picture(&at.join("c.png")).iter().map(|p| p[0]).collect();
    assert!(levels.contains(&0.0) && levels.iter().any(|v| *v > 0.1), "empty pixels have none");

    done(at, &["export", "a.safetensors", "--out", "a.ply"]);
    done(at, &["import", "a.ply", "--out", "b.safetensors"]);
    let error = refused(at, &[&render[..], &["b.safetensors"]].concat());
    assert!(error.contains("--output") && error.contains("no confidence"), "{error}");
    let error = refused(at, &["capture", "next", "b.safetensors"]);
    assert!(error.contains("b.safetensors"), "{error}");
}

#[test]
fn next_photographs_are_places_that_can_be_rendered() {
    let folder = trained();
    let at = folder.path();
    let [list, _] = done(at, &["capture", "next", "a.safetensors", "--count", "3", "--out", "next.json"]);
    let rows: Vec<Vec<&str>> = list.lines().skip(1).map(|row| row.split_whitespace().collect()).collect();
    assert_eq!(rows.len(), 3, "{list}");
    let cameras: Vec<&str> = rows.iter().map(|row| row[1]).collect();
    assert!(cameras[0] != cameras[1] && cameras[1] != cameras[2] && cameras[0] != cameras[2], "{list}");
    let render =
        ["render", "a.safetensors", "--path", "next.json", "--device", "cpu", "--resolution", "16x16"];
    done(at, &[&render[..], &["--out", "next/%02d.png"]].concat());
    assert!(at.join("next/03.png").is_file() && !at.join("next/04.png").exists());

    let among = ["capture", "next", "a.safetensors", "--among", "next.json", "--count", "9"];
    assert_eq!(done(at, &among)[0].lines().count(), 1 + 3, "each camera of the file once");
    fs::write(at.join("wrong.json"), r#"{"cameras": [{}]}"#).unwrap();
    let error = refused(at, &["capture", "next", "a.safetensors", "--among", "wrong.json"]);
    assert!(error.contains("wrong.json"), "{error}");
}

#[test]
fn delit_photographs_have_layers_of_their_size() {
    let folder = trained();
    let at = folder.path();
    done(at, &["delight", "capture.zip", "a.safetensors", "--out", "all", "--device", "cpu"]);
    assert_eq!(fs::read_dir(at.join("all")).unwrap().count(), 7, "an .exr for each photograph");
    let png =
        ["delight", "capture.zip", "a.safetensors", "--out", "png", "--format", "png", "--device", "cpu"];
    let [_, log] = done(at, &[&png[..], &["--name", "test"]].concat());
    assert!(log.contains("1 photograph to png"), "{log}");
    for layer in ["albedo", "model_albedo", "shading", "shadow", "specular"] {
        let files: Vec<_> = fs::read_dir(at.join("png").join(layer)).unwrap().collect();
        let pixels = picture(&files[0].as_ref().unwrap().path());
        assert!(files.len() == 1 && pixels.len() == 32 * 32, "{layer}");
        assert!(pixels.iter().any(|p| p[3] > 0.9) && pixels.iter().any(|p| p[3] == 0.0), "{layer}");
    }
    let error = refused(at, &[&png[..], &["--name", "nowhere"]].concat());
    assert!(error.contains("--name nowhere"), "{error}");
}

#[test]
fn exports_have_at_most_the_given_number_of_gaussians_and_bytes() {
    let folder = trained();
    let at = folder.path();
    let count =
        |file: &str| splat_import::decode(&fs::read(at.join(file)).unwrap()).unwrap().model.gaussians.len();
    let export = ["export", "a.safetensors", "--layer", "radiance"];
    done(at, &[&export[..], &["--out", "all.ply"]].concat());
    let all = count("all.ply");
    let half = (all / 2).to_string();
    let [_, log] = done(at, &[&export[..], &["--out", "half.ply", "--max-splats", &half]].concat());
    assert!(log.contains(&format!("kept {half} of {all} Gaussians")) && log.contains("dB"), "{log}");
    assert_eq!(count("half.ply"), all / 2);
    let bytes = fs::metadata(at.join("all.ply")).unwrap().len() / 3;
    let megabytes = (bytes as f64 / 1e6).to_string();
    done(at, &[&export[..], &["--out", "small.ply", "--max-mb", &megabytes]].concat());
    let found = fs::metadata(at.join("small.ply")).unwrap().len();
    assert!(found <= bytes && found > bytes * 9 / 10, "{found} of {bytes}");
    let [_, log] = done(at, &[&export[..], &["--out", "same.ply", "--max-splats", "99999999"]].concat());
    assert!(!log.contains("kept"), "{log}");
    assert_eq!(fs::read(at.join("same.ply")).unwrap(), fs::read(at.join("all.ply")).unwrap());

    let error = refused(at, &[&export[..], &["--max-mb", "0.00001"]].concat());
    assert!(error.contains("cannot hold a Gaussian"), "{error}");
    assert!(refused(at, &[&export[..], &["--max-mb", "-1"]].concat()).contains("above 0"));
    assert!(refused(at, &[&export[..], &["--max-splats", "0"]].concat()).contains("--max-splats"));
}
