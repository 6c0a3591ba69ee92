//! The command line under schedulers: progress as lines, a stop that keeps the progress, single frames of a
//! sequence (in `render_sequence`).

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use relume_capture::formats::model_file;
use serde_json::Value;
use tempfile::TempDir;

use crate::service_support::capture_zip;

/// `relume train` with settings for about a second; `more` sets the steps.
fn train(folder: &Path, more: &[&str]) -> Command {
    std::fs::write(folder.join("scan.zip"), capture_zip()).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
    command.args(["train", "scan.zip", "--preset", "draft", "--resolution", "32", "--device", "cpu"]);
    command.args(["--set", "max_gaussians=64", "--no-sheet"]).args(more).current_dir(folder);
    command
}

fn lines(output: &Output) -> Vec<String> {
    String::from_utf8(output.stdout.clone()).unwrap().lines().map(str::to_owned).collect()
}

fn events(output: &Output) -> Vec<Value> {
    lines(output).iter().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn json_progress_writes_one_object_per_line() {
    let folder = TempDir::new().unwrap();
    let json = ["--iterations", "12", "--progress", "json", "--out", "m.safetensors"];
    let output = train(folder.path(), &json).output().unwrap();
    assert_eq!(output.status.code(), Some(0));
    let events = events(&output);
    let steps: Vec<_> = events.iter().filter(|event| event["event"] == "step").collect();
    let (first, last) = (steps.first().unwrap(), steps.last().unwrap());
    assert_eq!((&first["step"], &last["step"], &last["total"]), (&1.into(), &12.into(), &12.into()));
    assert!(["loss", "psnr", "eta_seconds"].iter().all(|field| last[field].is_f64()), "{last}");
    assert!(last["gaussians"].as_u64().unwrap() <= 64 && last["eta_seconds"] == 0.0, "{last}");
    let done = events.last().unwrap();
    assert_eq!((&done["event"], &done["wrote"]), (&"done".into(), &"m.safetensors".into()));
    assert_eq!(done["summary"].as_array().unwrap().len(), 3, "{done}");
    assert!(events.iter().any(|event| event["event"] == "status"), "{events:?}");

    let output = train(folder.path(), &["--progress", "json", "--set", "speed=11"]).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let failed = self::events(&output).pop().unwrap();
    assert!(failed["event"] == "failed" && failed["error"].as_str().unwrap().contains("speed"), "{failed}");

    let output = train(folder.path(), &["--iterations", "2", "--out", "n.safetensors"]).output().unwrap();
    assert!(output.status.success() && output.stdout.is_empty(), "people read standard error");
    assert_eq!(train(folder.path(), &["--progress", "xml"]).output().unwrap().status.code(), Some(2));
}

#[test]
fn openjd_progress_follows_the_openjd_protocol() {
    let folder = TempDir::new().unwrap();
    let openjd = ["--iterations", "12", "--progress", "openjd", "--out", "m.safetensors"];
    let output = train(folder.path(), &openjd).output().unwrap();
    assert_eq!(output.status.code(), Some(0));
    let lines = lines(&output);
    let is_of_protocol =
        |line: &String| line.starts_with("openjd_progress: ") || line.starts_with("openjd_status: ");
    assert!(lines.iter().all(is_of_protocol), "{lines:?}");
    let percents: Vec<f64> =
        lines.iter().filter_map(|line| line.strip_prefix("openjd_progress: ")?.parse().ok()).collect();
    assert!(
        percents.is_sorted() && percents.first() == Some(&8.3) && percents.last() == Some(&100.0),
        "{percents:?}"
    );
    assert_eq!(lines.last().unwrap(), "openjd_status: wrote m.safetensors");

    let output = train(folder.path(), &["--progress", "openjd", "--light", "mars.hdr"]).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let last = self::lines(&output).pop().unwrap();
    assert!(last.starts_with("openjd_fail: ") && last.contains("mars.hdr"), "{last}");
}

#[cfg(unix)]
mod stops {
    use std::os::unix::process::ExitStatusExt;

    use super::*;

    /// A training that has completed its first step. The reader keeps its output open.
    fn started(folder: &Path, more: &[&str]) -> (Child, BufReader<std::process::ChildStdout>) {
        let mut command = train(folder, &[&["--progress", "json"], more].concat());
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut reader = BufReader::new(child.stdout.take().unwrap());
        let mut line = String::new();
        while !line.contains("\"step\":1,") {
            line.clear();
            assert!(reader.read_line(&mut line).unwrap() > 0, "it ended before its first step");
        }
        (child, reader)
    }

    fn send(child: &Child, signals: &[&str]) {
        let id = child.id();
        let script: Vec<_> = signals.iter().map(|signal| format!("kill -{signal} {id}")).collect();
        assert!(Command::new("sh").args(["-c", &script.join(" && ")]).status().unwrap().success());
    }

    #[test]
    fn a_stopped_training_resumes_to_the_same_model() {
        let folder = TempDir::new().unwrap();
        let at = folder.path();
        let steps = ["--iterations", "600", "--set", "checkpoint_every=100000"];
        let whole = [&steps[..], &["--out", "whole.safetensors"]].concat();
        assert!(train(at, &whole).output().unwrap().status.success());

        let kept = [&steps[..], &["--checkpoint", "c", "--out", "kept.safetensors"]].concat();
        for signal in ["TERM", "INT"] {
            let (mut child, mut reader) = started(at, &[&kept[..], &["--seed", "3"]].concat());
            send(&child, &[signal]);
            assert_eq!(child.wait().unwrap().code(), Some(75), "{signal}");
            let mut rest = String::new();
            std::io::Read::read_to_string(&mut reader, &mut rest).unwrap();
            let last: Value = serde_json::from_str(rest.lines().last().unwrap()).unwrap();
            assert!(
                last["event"] == "stopped" && last["text"].as_str().unwrap().contains("of 600"),
                "{last}"
            );
            assert!(at.join("c").exists() && !at.join("kept.safetensors").exists(), "{signal}");
            std::fs::remove_file(at.join("c")).unwrap();
        }

        let (mut child, _reader) = started(at, &kept);
        send(&child, &["TERM"]);
        assert_eq!(child.wait().unwrap().code(), Some(75));
        let output = train(at, &kept).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && said.contains("resuming from step"), "{said}");
        let model = |file: &str| model_file::decode(&std::fs::read(at.join(file)).unwrap()).unwrap();
        assert!(model("whole.safetensors").gaussians == model("kept.safetensors").gaussians);
        assert!(!at.join("c").exists(), "the checkpoint of a finished training");
    }

    #[test]
    fn without_a_checkpoint_a_signal_ends_training_at_once() {
        let folder = TempDir::new().unwrap();
        for (signal, number) in [("TERM", 15), ("INT", 2)] {
            let (mut child, _reader) = started(folder.path(), &["--iterations", "5000", "--no-checkpoint"]);
            send(&child, &[signal]);
            assert_eq!(child.wait().unwrap().signal(), Some(number), "{signal}");
        }
        assert!(!folder.path().join("model.safetensors").exists());
        assert!(!folder.path().join("model.safetensors.checkpoint").exists());
    }

    #[test]
    fn a_stopped_training_resumes_without_a_named_checkpoint() {
        let folder = TempDir::new().unwrap();
        let at = folder.path();
        let file = at.join("thing.safetensors.checkpoint");
        let steps = ["--iterations", "600", "--out", "thing.safetensors"];
        let (mut child, _reader) = started(at, &steps);
        send(&child, &["INT"]);
        assert_eq!(child.wait().unwrap().code(), Some(75));
        assert!(file.exists());

        let kept = std::fs::read(&file).unwrap();
        let others = [&steps[..], &["--seed", "3"]].concat();
        let output = train(at, &others).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && said.contains("run the command again"), "{said}");
        assert!(!file.exists());
        assert!(
            std::fs::read(at.join("thing.safetensors.checkpoint.old")).unwrap() == kept,
            "nothing is lost"
        );

        assert!(train(at, &others).output().unwrap().status.success(), "the same command again");

        std::fs::write(&file, kept).unwrap();
        let output = train(at, &steps).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && said.contains("resuming from step"), "{said}");
        assert!(!file.exists());
    }

    #[test]
    fn a_signal_that_is_sent_twice_saves_the_progress() {
        let folder = TempDir::new().unwrap();
        let (mut child, _reader) = started(folder.path(), &["--iterations", "5000", "--checkpoint", "c"]);
        let id = child.id();
        // The process may have ended before the repetition.
        let script = format!("kill -TERM {id}; sleep 0.05; kill -TERM {id} || true");
        assert!(Command::new("sh").args(["-c", &script]).stderr(Stdio::null()).status().unwrap().success());
        assert_eq!(child.wait().unwrap().code(), Some(75));
        assert!(folder.path().join("c").exists());
    }

    #[test]
    fn a_second_signal_ends_training_at_once() {
        let folder = TempDir::new().unwrap();
        let (mut child, _reader) = started(folder.path(), &["--iterations", "5000", "--checkpoint", "c"]);
        // Both signals are pending before the process continues.
        send(&child, &["STOP", "TERM", "INT", "CONT"]);
        let code = child.wait().unwrap().code();
        assert!(matches!(code, Some(130 | 143)), "{code:?}");
    }
}
