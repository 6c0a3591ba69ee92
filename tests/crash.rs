//! kill -9 of the server process at random moments, repeatedly.

use std::process::Command;
use std::time::Duration;

use futures::TryStreamExt;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use relume_api::JobId;
use relume_api::jobs::JobState;
use relume_client::{Client, JobEvent};
use reqwest::Method;
use tempfile::TempDir;

use crate::server_process::Server;
use crate::service_support::{CaptureZip, capture_zip, ended, files_under, small_job, until};

/// So many steps that ten starts with a short training each do not reach the end.
const STEPS: u32 = 1500;
const CHECKPOINT_EVERY: u32 = 10;
const KILLS: usize = 10;

/// Uploads the capture and submits a job on it, always with the same idempotency key.
async fn submit(client: &Client, steps: u32) -> JobId {
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    client.create_job(&small_job(&capture.id, steps, CHECKPOINT_EVERY), Some("once")).await.unwrap().id
}

async fn model_bytes(client: &Client, job: &JobId) -> Vec<u8> {
    let job = ended(client, job).await;
    assert_eq!(job.state, JobState::Succeeded, "{:?}", job.error);
    client.file(&job.model.unwrap(), "model.safetensors").await.unwrap().to_vec()
}

/// Follows the events until a checkpoint at or after `step`, and keeps them.
async fn hear_checkpoint(client: &Client, job: &JobId, step: i64, heard: &mut Vec<JobEvent>) {
    let after = heard.last().map_or(0, |e: &JobEvent| e.seq);
    let mut events = std::pin::pin!(client.events(job, after).await.unwrap());
    while let Some(event) = events.try_next().await.unwrap() {
        let reached = event.kind == "checkpoint" && event.data["step"].as_i64() >= Some(step);
        heard.push(event);
        if reached {
            return;
        }
    }
    panic!("the job ended before it could be killed at step {step}: STEPS is too small");
}

#[tokio::test(flavor = "multi_thread")]
async fn ten_kills_at_random_moments_change_no_byte_of_the_model() {
    let undisturbed = {
        let data = TempDir::new().unwrap();
        let server = Server::start(data.path());
        let job = submit(&server.client, STEPS).await;
        let bytes = model_bytes(&server.client, &job).await;
        // Negative control: the bytes depend on the settings of the job.
        let mut other = small_job(&server.client.job(&job).await.unwrap().capture, STEPS, CHECKPOINT_EVERY);
        other.overrides.seed = Some(1);
        let other = server.client.create_job(&other, None).await.unwrap();
        assert_ne!(model_bytes(&server.client, &other.id).await, bytes);
        bytes
    };

    let data = TempDir::new().unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let mut server = Server::start(data.path());
    let job = submit(&server.client, STEPS).await;
    let mut heard = Vec::new();
    for kill in 0..KILLS {
        // Half of the kills happen during the training, each later than the last; half at a random moment of
        // a start.
        if kill % 2 == 0 {
            let step = (kill + 1) * STEPS as usize * 8 / 10 / KILLS;
            hear_checkpoint(&server.client, &job, step as i64, &mut heard).await;
            tokio::time::sleep(Duration::from_millis(random.random_range(0..30))).await;
        } else {
            tokio::time::sleep(Duration::from_millis(random.random_range(0..100))).await;
        }
        server.kill();
        server = Server::start(data.path());
    }

    assert_eq!(model_bytes(&server.client, &job).await, undisturbed);
    let view = server.client.job(&job).await.unwrap();
    assert!(view.attempts > KILLS as i64 / 2, "killed while it ran: {} attempts", view.attempts);
    assert_eq!(server.client.models().await.unwrap().items.len(), 1, "published once");
    let mut history = Vec::new();
    server.client.wait(&job, |event| history.push(event.clone())).await.unwrap();
    assert!(heard.iter().all(|event| history.contains(event)), "a restart loses no event");
    let succeeded = history.iter().filter(|e| e.data["state"] == "succeeded").count();
    assert_eq!(succeeded, 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_accepted_job_and_its_capture_survive_kill_9() {
    let data = TempDir::new().unwrap();
    let server = Server::start(data.path());
    let job = submit(&server.client, 200).await;
    server.kill();
    let server = Server::start(data.path());
    let again = submit(&server.client, 200).await;
    assert_eq!(again, job, "the idempotency key survived too");
    assert_eq!(ended(&server.client, &job).await.state, JobState::Succeeded);
}

#[tokio::test(flavor = "multi_thread")]
async fn startup_removes_only_the_partial_upload_of_a_killed_server() {
    let data = TempDir::new().unwrap();
    let server = Server::start(data.path());
    let (sender, receiver) = futures::channel::mpsc::unbounded::<Result<Vec<u8>, std::io::Error>>();
    let request = server.client.request(Method::POST, "/v1/captures").unwrap();
    let request =
        request.header("content-type", "application/zip").body(reqwest::Body::wrap_stream(receiver));
    let upload = tokio::spawn(request.send());
    sender.unbounded_send(Ok(vec![0; 8 << 20])).unwrap();
    let artifacts = data.path().join("artifacts");
    while files_under(&artifacts).iter().all(|(_, size)| *size < 1 << 20) {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    server.kill();
    assert!(upload.await.unwrap().is_err());
    std::fs::write(artifacts.join("not-ours"), "a stranger's file").unwrap();
    let server = Server::start(data.path());
    server.client.models().await.unwrap();
    assert_eq!(files_under(&artifacts), [("not-ours".to_owned(), 17)]);
}

#[tokio::test(flavor = "multi_thread")]
async fn sigterm_writes_a_checkpoint_and_exits_successfully() {
    let data = TempDir::new().unwrap();
    let mut server = Server::start(data.path());
    let job = submit(&server.client, 200).await;
    until(&server.client, &job, |job| job.state == JobState::Running).await;
    let terminated = Command::new("kill").arg(server.child.id().to_string()).status().unwrap();
    assert!(terminated.success());
    assert!(server.child.wait().unwrap().success());
    let server = Server::start(data.path());
    assert_eq!(ended(&server.client, &job).await.state, JobState::Succeeded);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_disk_answers_507_without_corruption() {
    let data = TempDir::new().unwrap();
    // No file may exceed 1 MiB. The server gets the same error as from a quota.
    let mut shell = Command::new("bash");
    shell.args(["-c", "trap '' XFSZ; ulimit -f 1024; exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_relume")]);
    let server = Server::start_under(shell, data.path());
    let mut large = CaptureZip::new(8, 32);
    large.images.push(("noise.bin".to_owned(), noise(4 << 20)));
    let error = server.client.upload_capture_bytes(large.zip()).await.unwrap_err();
    let problem = error.problem().unwrap_or_else(|| panic!("{error}"));
    assert_eq!((problem.status, problem.kind.as_str()), (507, "urn:relume:problem:insufficient-storage"));
    assert!(files_under(data.path()).is_empty(), "nothing is left behind");
    // The server still accepts a capture that fits.
    let capture = server.client.upload_capture_bytes(capture_zip()).await.unwrap();
    assert_eq!(server.client.captures().await.unwrap().items, [capture]);
}

/// Incompressible bytes.
pub fn noise(count: usize) -> Vec<u8> {
    let mut bytes = vec![0; count];
    rand::Rng::fill_bytes(&mut ChaCha8Rng::seed_from_u64(1), &mut bytes);
    bytes
}
