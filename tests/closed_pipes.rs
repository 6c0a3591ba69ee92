//! Commands whose reader has closed the pipe, as in `relume explain MODEL | head`: they end quietly.

use std::path::Path;
use std::process::{Command, Output, Stdio};

use relume_fixtures::small_set::nerfstudio;
use tempfile::TempDir;

use crate::service_support::capture_zip;

/// The exit code that `--help` states for a closed pipe.
const CLOSED_PIPE: i32 = 141;

/// The output of a command, whose standard output is `out`.
fn relume(arguments: &[&str], folder: &Path, out: Stdio) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
    command.args(arguments).current_dir(folder).stdout(out).stderr(Stdio::piped());
    command.spawn().unwrap().wait_with_output().unwrap()
}

#[test]
fn commands_end_quietly_when_their_reader_closes_the_pipe() {
    let folder = TempDir::new().unwrap();
    for (name, bytes) in nerfstudio(|_| ()) {
        let path = folder.path().join("capture").join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
    std::fs::write(folder.path().join("capture.zip"), capture_zip()).unwrap();
    let train =
        "train capture.zip --preset draft --iterations 3 --device cpu --no-sheet --out model.safetensors";
    let trained = relume(&train.split(' ').collect::<Vec<_>>(), folder.path(), Stdio::null());
    assert!(trained.status.success(), "{trained:?}");
    for command in ["openapi", "doctor --device cpu", "capture check capture", "explain model.safetensors"] {
        let arguments: Vec<&str> = command.split(' ').collect();
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let output = relume(&arguments, folder.path(), writer.into());
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(CLOSED_PIPE), "{command}: {said}");
        assert!(!said.contains("panicked") && !said.contains("pipe"), "{command}: {said}");
        let read = relume(&arguments, folder.path(), Stdio::piped());
        assert!(read.status.success() && !read.stdout.is_empty(), "the control: {command} {read:?}");
    }
}
