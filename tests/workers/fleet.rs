//! Shared code of the tests of workers: a server without local workers, and workers as processes.

use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

use relume::server::{ServerConfig, Trainers};
use relume::testing::{TestServer, spawn_with};
use relume_api::jobs::{JobState, NewJob};
use relume_api::work::{Claimed, WorkerHello};
use relume_api::{CaptureId, JobId};
use relume_client::Client;
use tempfile::TempDir;

use crate::service_support::{capture_zip, ended, small_job};

/// Configures a server without local workers that soon detects missing heartbeats.
pub fn without_workers(config: &mut ServerConfig) {
    config.trainers = Trainers::None;
    config.lease.heartbeat_timeout = Duration::from_secs(2);
}

/// Starts such a server.
pub async fn spawn_server() -> TestServer {
    spawn_with(TempDir::new().unwrap(), without_workers).await.unwrap()
}

/// Uploads the small capture.
pub async fn upload(client: &Client) -> CaptureId {
    client.upload_capture_bytes(capture_zip()).await.unwrap().id
}

/// A worker process, which is killed with the test.
pub struct Process(pub Child);

impl Process {
    /// `relume worker` for a server, with its own cache in `folder`.
    pub fn start(client: &Client, folder: &Path, args: &[&str]) -> Self {
        Self::start_with(client, folder, args, Vec::new())
    }

    /// As [`Self::start`], with additional environment variables.
    pub fn start_with(
        client: &Client,
        folder: &Path,
        args: &[&str],
        environment: Vec<(&str, String)>,
    ) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
        command.envs(environment);
        command.args(["worker", "--device", "cpu", "--server", client.base().as_str(), "--cache"]);
        command.arg(folder.join("cache")).args(args).env_remove("RELUME_API_KEY");
        Self(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap())
    }

    /// Waits for its end.
    pub async fn end(&mut self) -> ExitStatus {
        for _ in 0..1200 {
            if let Some(status) = self.0.try_wait().unwrap() {
                return status;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        panic!("the worker does not end");
    }

    /// Terminates it with a signal.
    pub fn terminate(&self) {
        let pid = rustix::process::Pid::from_child(&self.0);
        rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

/// A worker that the test simulates.
pub fn hello(id: &str) -> WorkerHello {
    WorkerHello {
        id: id.into(),
        name: format!("{id} of the test"),
        device: "cpu".to_owned(),
        has_gpu: false,
        labels: Vec::new(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
    }
}

/// Claims until there is a job.
pub async fn claimed(client: &Client, hello: &WorkerHello) -> Claimed {
    for _ in 0..400 {
        let claimed = client.claim_job(hello).await.unwrap();
        if claimed.task.is_some() {
            return claimed;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    panic!("no job is given to {hello:?}");
}

/// The hash of the model that a local worker trains for a job on the small capture.
pub async fn undisturbed(job: impl Fn(&CaptureId) -> NewJob) -> String {
    let server = relume::testing::spawn().await.unwrap();
    let capture = upload(server.client()).await;
    let id = server.client().create_job(&job(&capture), None).await.unwrap().id;
    let hash = model_hash(server.client(), &id).await;
    server.stop().await.unwrap();
    hash
}

/// The hash of the model of a job, once it has succeeded.
pub async fn model_hash(client: &Client, job: &JobId) -> String {
    let done = ended(client, job).await;
    assert_eq!(done.state, JobState::Succeeded, "{done:?}");
    let model = client.model(&done.model.unwrap()).await.unwrap();
    model.files.into_iter().find(|file| file.name == "model.safetensors").unwrap().sha256
}

/// A job that takes one to two seconds.
pub fn short_job(capture: &CaptureId) -> NewJob {
    small_job(capture, 150, 25)
}
