//! `relume materials` and `--recolour`: lists and changes materials of a model file.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use relume_capture::formats::image_file;
use relume_capture::{SyntheticOptions, synthetic, write_archive};
use tempfile::TempDir;

fn relume(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_relume")).current_dir(folder).args(arguments).output().unwrap()
}

/// Runs a command that must succeed. Returns its standard output.
fn done(folder: &Path, arguments: &[&str]) -> String {
    let output = relume(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// The error of a command that must fail.
fn refused(folder: &Path, arguments: &[&str]) -> String {
    let output = relume(folder, arguments);
    assert!(!output.status.success(), "{arguments:?}");
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Mean linear red, green and blue of the albedo where the model covers the picture.
fn mean_albedo(folder: &Path, options: &[&str]) -> [f32; 3] {
    let render = [
        "render",
        "a.safetensors",
        "--size",
        "64",
        "--device",
        "cpu",
        "--output",
        "albedo",
        "--out",
        "albedo.png",
    ];
    done(folder, &[&render[..], options].concat());
    let image = image_file::decode(&fs::read(folder.join("albedo.png")).unwrap(), 64 * 64).unwrap();
    let covered: Vec<_> = image.pixels.iter().filter(|pixel| pixel[3] > 0.9).collect();
    assert!(covered.len() > 100, "{} pixels", covered.len());
    std::array::from_fn(|c| {
        covered.iter().map(|pixel| relume_scene::srgb::decode(pixel[c])).sum::<f32>() / covered.len() as f32
    })
}

#[test]
fn recoloured_models_have_the_colour_of_the_change() {
    let folder = TempDir::new().unwrap();
    let at = folder.path();
    let options =
        SyntheticOptions { size: 32, train_views: 6, test_views: 1, paths: 4, ..Default::default() };
    fs::write(at.join("capture.zip"), write_archive(&synthetic(&options).unwrap()).unwrap()).unwrap();
    let train = ["train", "capture.zip", "--preset", "draft", "--iterations", "60", "--set", "prototypes=1"];
    let out = ["--resolution", "32", "--device", "cpu", "--no-sheet", "--out", "a.safetensors"];
    done(at, &[&train[..], &out].concat());

    let plain = mean_albedo(at, &[]);
    let change = "0=#204080,0.roughness=0.25";
    let blue = mean_albedo(at, &["--recolour", change]);
    assert!(blue[2] > 2.0 * blue[1] && blue[1] > 2.0 * blue[0], "{blue:?}");
    assert!(!(plain[2] > 2.0 * plain[1]), "the control: {plain:?}");
    let listed = done(
        at,
        &["materials", "a.safetensors", "--recolour", change, "--save", "blue.json", "--masks", "masks"],
    );
    let row = listed.lines().nth(1).unwrap();
    assert!(row.contains("100.0 %") && row.contains("0.25"), "{listed}");
    assert!(at.join("masks/material_0.png").is_file());
    assert_eq!(mean_albedo(at, &["--edits", "blue.json"]), blue);
    assert_eq!(mean_albedo(at, &["--edits", "blue.json", "--recolour", "0*=0"]), [0.0; 3]);
    done(at, &["export", "a.safetensors", "--edits", "blue.json", "--out", "blue.ply"]);
    done(at, &["export", "a.safetensors", "--out", "plain.ply"]);
    assert_ne!(fs::read(at.join("blue.ply")).unwrap(), fs::read(at.join("plain.ply")).unwrap());

    assert!(
        refused(at, &["render", "a.safetensors", "--recolour", "7*=2"]).contains("materials 0 to 0, not 7")
    );
    assert!(refused(at, &["render", "a.safetensors", "--recolour", "red"]).contains("3=#224488"));
    fs::write(at.join("wrong.json"), r#"[{"material": 0, "roughness": 2}]"#).unwrap();
    let error = refused(at, &["render", "a.safetensors", "--edits", "wrong.json"]);
    assert!(error.contains("wrong.json: [0].roughness: must be 0 to 1"), "{error}");
    fs::write(at.join("wrong.json"), r#"[{"material": 0, "colour": "blue"}]"#).unwrap();
    let error = refused(at, &["render", "a.safetensors", "--edits", "wrong.json"]);
    assert!(error.contains("wrong.json: [0].colour"), "{error}");
}
