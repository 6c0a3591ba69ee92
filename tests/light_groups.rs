//! Captures under several lights: `--light-group`, `light_groups` in jobs, and `recovered:GROUP` in pictures.

use std::fs;
use std::path::Path;
use std::process::{self, Command};

use relume::testing;
use relume_api::jobs::JobState;
use relume_capture::{SyntheticOptions, synthetic, write_archive};
use relume_client::ClientError;
use relume_spec::training::TrainOverrides;
use reqwest::StatusCode;
use tempfile::TempDir;

use crate::service_support::{capture_zip, ended, small_job};

fn relume(folder: &Path, arguments: &[&str]) -> process::Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
    command.current_dir(folder).args(arguments).output().unwrap()
}

fn told(output: &process::Output) -> String {
    String::from_utf8_lossy(&[output.stdout.as_slice(), &output.stderr].concat()).into_owned()
}

/// A folder with a capture of six photographs.
fn capture() -> TempDir {
    let folder = TempDir::new().unwrap();
    let options =
        SyntheticOptions { size: 32, train_views: 6, test_views: 1, paths: 4, ..Default::default() };
    fs::write(folder.path().join("capture.zip"), write_archive(&synthetic(&options).unwrap()).unwrap())
        .unwrap();
    folder
}

fn train(folder: &Path, groups: &[&str]) -> process::Output {
    let small =
        ["--preset", "draft", "--resolution", "32", "--iterations", "40", "--device", "cpu", "--no-sheet"];
    let groups: Vec<&str> = groups.iter().flat_map(|group| ["--light-group", group]).collect();
    relume(folder, &[&["train", "capture.zip", "--out", "a.safetensors"], &small[..], &groups].concat())
}

#[test]
fn light_groups_of_a_training_are_lights_of_its_model() {
    let folder = capture();
    let at = folder.path();
    let output = train(at, &["day=train_00[0-2]/*", "night=train_*[345]/*"]);
    assert!(output.status.success(), "{}", told(&output));
    let explained = told(&relume(at, &["explain", "a.safetensors"]));
    assert!(explained.contains("2 light groups, each with a light: day, night"), "{explained}");
    let render = |env: &str, out: &str| {
        let size = ["--size", "32", "--device", "cpu", "--out", out];
        relume(at, &[&["render", "a.safetensors", "--env", env], &size[..]].concat())
    };
    for (env, out) in [("recovered", "r.png"), ("recovered:day", "d.png"), ("recovered:night", "n.png")] {
        let output = render(env, out);
        assert!(output.status.success(), "{env}: {}", told(&output));
    }
    let read = |name: &str| fs::read(at.join(name)).unwrap();
    assert!(read("r.png") == read("d.png") && read("d.png") != read("n.png"));
    let refused = render("recovered:noon", "x.png");
    assert!(!refused.status.success() && !at.join("x.png").exists());
    let said = told(&refused);
    assert!(said.contains("noon") && said.contains("day, night"), "{said}");
    let compared = relume(at, &["eval", "a.safetensors", "--capture", "capture.zip", "--device", "cpu"]);
    assert!(compared.status.success() && !told(&compared).contains("warning"), "{}", told(&compared));
}

#[test]
fn light_groups_that_fit_no_photograph_are_refused_by_name() {
    let folder = capture();
    for (groups, says) in [
        (&["dusk=IMG_*"][..], "dusk"),
        (&["day=train_*", "night=*002*"], "`day` and `night`"),
        (&["day=train_000*", "day=train_001*"], "`day` is given twice"),
        (&["two words=train_*"], "light_groups.two words"),
        (&["day"], "NAME=PATTERN"),
    ] {
        let output = train(folder.path(), groups);
        assert!(!output.status.success(), "{groups:?}");
        assert!(told(&output).contains(says), "{groups:?}: {}", told(&output));
        assert!(!folder.path().join("a.safetensors").exists(), "{groups:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn light_groups_of_a_job_are_lights_of_its_pictures() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    let mut job = small_job(&capture.id, 10, 5);
    let groups = [("day".to_owned(), "r_[01].png".to_owned())];
    job.overrides = TrainOverrides { light_groups: Some(groups.into()), ..job.overrides };
    let job = ended(client, &client.create_job(&job, None).await.unwrap().id).await;
    assert_eq!(job.state, JobState::Succeeded, "{:?}", job.error);
    let model = job.model.unwrap();
    let picture = async |light: &str| client.thumbnail(&model, &format!("size=64&env={light}")).await;
    let day = picture("recovered:day").await.unwrap();
    assert_ne!(day, picture("recovered").await.unwrap(), "that of the other photographs");
    let error = picture("recovered:night").await.unwrap_err();
    let ClientError::Problem(problem) = &error else { panic!("{error}") };
    assert_eq!(problem.status, StatusCode::UNPROCESSABLE_ENTITY.as_u16());
    let said = error.to_string();
    assert!(said.contains("night") && said.contains("day"), "{said}");
}
