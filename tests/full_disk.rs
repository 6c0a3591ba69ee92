//! A disk that is temporarily full: clear refusals, and no restart afterwards.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use relume_api::exports::ExportState;
use relume_api::jobs::JobState;
use relume_api::{CaptureId, ExportId, ModelId, Problem};
use relume_client::{Client, ClientError};
use reqwest::Method;
use serde_json::json;
use tempfile::TempDir;

use crate::server_process::Server;
use crate::service_exports;
use crate::service_support::{CaptureZip, capture_zip, ended, files_under, small_job, trained, until};

/// More steps than any test needs.
const ENDLESS: u32 = 1_000_000;

/// The answer of `/readyz`.
async fn readiness(client: &Client) -> (u16, String) {
    let answer = client.request(Method::GET, "/readyz").unwrap().send().await.unwrap();
    (answer.status().as_u16(), answer.text().await.unwrap())
}

async fn until_not_ready(client: &Client) -> String {
    for _ in 0..500 {
        match readiness(client).await {
            (503, why) => return why,
            _ => tokio::time::sleep(Duration::from_millis(20)).await,
        }
    }
    panic!("the server never noticed");
}

fn is_507<T: std::fmt::Debug>(answer: Result<T, ClientError>) -> bool {
    let error = answer.expect_err("there is no room for it");
    let kind = |problem: &Problem| (problem.status, problem.kind.clone());
    error.problem().map(kind) == Some((507, "urn:relume:problem:insufficient-storage".to_owned()))
}

async fn start_job(client: &Client, steps: u32) -> relume_api::jobs::JobView {
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    client.create_job(&small_job(&capture.id, steps, 200), None).await.unwrap()
}

/// A server for [`let_files_grow`].
fn server_with_limitable_files(data: &Path) -> Server {
    let mut shell = Command::new("bash");
    shell.args(["-c", "trap '' XFSZ; exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_relume")]);
    Server::start_under(shell, data)
}

/// Permits or forbids the growth of a process's files.
fn let_files_grow(server: &Server, grow: bool) {
    let limit = if grow { "--fsize=unlimited:" } else { "--fsize=0:" };
    let done = Command::new("prlimit").args(["--pid", &server.child.id().to_string(), limit]).status();
    assert!(done.unwrap().success());
}

#[tokio::test(flavor = "multi_thread")]
async fn after_a_full_disk_writes_succeed_and_training_resumes() {
    let data = TempDir::new().unwrap();
    let server = server_with_limitable_files(data.path());
    let client = &server.client;
    let job = start_job(client, ENDLESS).await;
    until(client, &job.id, |job| job.state == JobState::Running && job.progress.step > 1000).await;

    let_files_grow(&server, false);
    // The worker has released the reserve to record that the job waits, but the write failed.
    let reserve = data.path().join("relume.db.reserve");
    let mut waited = 0;
    while reserve.exists() {
        waited += 1;
        assert!(waited < 1000, "the training does not notice that its checkpoints fail");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let why = until_not_ready(client).await;
    assert!(why.contains("the disk is full"), "{why}");
    for _ in 0..10 {
        assert!(is_507(client.create_job(&small_job(&job.capture, 5, 5), None).await));
        assert!(is_507(client.upload_capture_bytes(CaptureZip::new(9, 32).zip()).await));
        assert_eq!(client.captures().await.unwrap().items.len(), 1, "what is there can be read");
    }

    let_files_grow(&server, true);
    let next = client.create_job(&small_job(&job.capture, 5, 5), None).await.unwrap();
    assert_eq!(readiness(client).await, (200, "ready\n".to_owned()));
    let resumed = until(client, &job.id, |job| job.state == JobState::Running && job.attempts == 2).await;
    assert!(resumed.progress.step > 0, "it went on from a checkpoint: {:?}", resumed.progress);
    client.cancel_job(&job.id).await.unwrap();
    assert_eq!(ended(client, &job.id).await.state, JobState::Cancelled);
    assert_eq!(ended(client, &next.id).await.state, JobState::Succeeded);
    nothing_is_left_of(data.path(), &job.capture, 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn thumbnails_are_served_but_not_cached_while_the_disk_is_full() {
    let data = TempDir::new().unwrap();
    let server = server_with_limitable_files(data.path());
    let model = trained(&server.client).await.model.unwrap();
    let was_rendered = async || {
        let path = format!("/v1/models/{model}/thumbnail?size=16");
        let answer = server.client.request(Method::GET, &path).unwrap().send().await.unwrap();
        assert_eq!(answer.status(), 200);
        answer.headers().contains_key("server-timing")
    };
    let_files_grow(&server, false);
    assert!(was_rendered().await && was_rendered().await, "nothing could be kept");
    let left = files_under(data.path());
    assert!(!left.iter().any(|(name, _)| name.starts_with("cache/")), "{left:?}");
    let_files_grow(&server, true);
    // A check may have found the disk full in between.
    assert_eq!(readiness(&server.client).await.0, 200);
    assert!(was_rendered().await);
    assert!(!was_rendered().await, "the control");
}

/// Queues a turntable and waits until some of its frames are made.
async fn running_export(client: &Client, model: &ModelId, frames: u32) -> ExportId {
    let body = json!({ "kind": "frames", "turntable": { "frames": frames }, "width": 64, "height": 64 });
    let export = service_exports::queued(client, model, &body).await;
    service_exports::until(client, &export.id, |export| export.progress.done >= 5).await.id
}

#[tokio::test(flavor = "multi_thread")]
async fn an_export_pauses_while_the_disk_is_full() {
    let data = TempDir::new().unwrap();
    let server = server_with_limitable_files(data.path());
    let client = &server.client;
    let model = trained(client).await.model.unwrap();
    let id = running_export(client, &model, 500).await;
    let_files_grow(&server, false);
    let why = until_not_ready(client).await;
    assert!(why.contains("the disk is full"), "{why}");
    let export = client.export(&id).await.unwrap();
    assert!(!export.state.is_terminal() && export.progress.done < 500, "the control: {export:?}");
    let_files_grow(&server, true);
    let export = service_exports::ended(client, &id).await;
    assert_eq!(export.state, ExportState::Succeeded, "{:?}", export.error);
}

/// The artifacts are one capture and `files` files of models.
fn nothing_is_left_of(data: &Path, capture: &CaptureId, files: usize) {
    let names: Vec<String> = files_under(data).into_iter().map(|(name, _)| name).collect();
    let models =
        names.iter().filter(|name| name.starts_with("artifacts/attempts/") && name.contains("/model."));
    assert_eq!((models.count(), names.len()), (files, files + 1), "of {capture:?}: {names:?}");
}

/// A server on its own file system of 20 MB.
struct SmallDisk {
    server: Server,
    /// Path of the file system for the test.
    disk: PathBuf,
    _mount_point: TempDir,
}

impl SmallDisk {
    fn start() -> Self {
        let mount_point = TempDir::new().unwrap();
        let mut shell = Command::new("unshare");
        let script = "mount -t tmpfs -o size=20m tmpfs \"$0\" && exec \"$@\"";
        shell.args(["--user", "--map-root-user", "--mount", "sh", "-c", script]);
        shell.arg(mount_point.path()).arg(env!("CARGO_BIN_EXE_relume"));
        let server = Server::start_under(shell, &mount_point.path().join("data"));
        let inside = mount_point.path().strip_prefix("/").unwrap();
        let disk = PathBuf::from(format!("/proc/{}/root", server.child.id())).join(inside);
        Self { server, disk, _mount_point: mount_point }
    }

    fn signal(&self, signal: &str) {
        let sent = Command::new("kill").args([signal, &self.server.child.id().to_string()]).status();
        assert!(sent.unwrap().success());
    }

    /// Fills the disk completely, unless the reserve is already released. The server is suspended during
    /// this.
    fn fill(&self) {
        self.signal("-STOP");
        if self.disk.join("data/relume.db.reserve").exists() {
            let mut filler = std::fs::File::options().create(true).append(true).open(self.filler()).unwrap();
            while filler.write(&[0; 4096]).is_ok() {}
        }
        self.signal("-CONT");
    }

    fn filler(&self) -> PathBuf {
        self.disk.join("filler")
    }
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs Linux that lets users mount a tmpfs in a namespace of their own"]
async fn training_pauses_at_its_checkpoint_while_the_disk_is_full() {
    let small = SmallDisk::start();
    let client = &small.server.client;
    let job = start_job(client, ENDLESS).await;
    until(client, &job.id, |job| job.state == JobState::Running && job.progress.step > 1000).await;

    let mut paused = client.job(&job.id).await.unwrap();
    for _ in 0..100 {
        if paused.state == JobState::Queued {
            break;
        }
        small.fill();
        tokio::time::sleep(Duration::from_millis(200)).await;
        paused = client.job(&job.id).await.unwrap();
    }
    assert_eq!(paused.progress.message.as_deref(), Some("waiting for disk space"));
    assert!(paused.progress.step >= 1000 && paused.progress.step % 200 == 0, "{:?}", paused.progress);
    let (status, why) = readiness(client).await;
    assert!(status == 503 && why.contains("the disk is full"), "{status} {why}");
    assert!(is_507(client.create_job(&small_job(&job.capture, 5, 5), None).await));
    let mut large = CaptureZip::new(8, 32);
    large.images.push(("unused.bin".to_owned(), crate::crash::noise(4 << 20)));
    assert!(is_507(client.upload_capture_bytes(large.zip()).await));
    assert_eq!(client.job(&job.id).await.unwrap().state, JobState::Queued, "it is not tried over and over");

    std::fs::remove_file(small.filler()).unwrap();
    let next = client.create_job(&small_job(&job.capture, 5, 5), None).await.unwrap();
    assert_eq!(readiness(client).await.0, 200);
    let going_on = |view: &relume_api::jobs::JobView| {
        view.state == JobState::Running && view.progress.step > paused.progress.step
    };
    assert_eq!(until(client, &job.id, going_on).await.attempts, 2);
    client.cancel_job(&job.id).await.unwrap();
    assert_eq!(ended(client, &job.id).await.state, JobState::Cancelled);
    assert_eq!(ended(client, &next.id).await.state, JobState::Succeeded);
    nothing_is_left_of(&small.disk.join("data"), &job.capture, 2);
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs Linux that lets users mount a tmpfs in a namespace of their own"]
async fn an_export_is_cancelled_and_deleted_on_a_full_disk() {
    let small = SmallDisk::start();
    let client = &small.server.client;
    let model = trained(client).await.model.unwrap();
    let id = running_export(client, &model, 10_000).await;
    small.fill();
    until_not_ready(client).await;
    client.delete_export(&id).await.unwrap();
    assert_eq!(client.export(&id).await.unwrap().state, ExportState::Cancelled);
    client.delete_export(&id).await.unwrap();
    assert!(client.export(&id).await.is_err(), "it is deleted");
}
