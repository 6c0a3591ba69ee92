//! Several machines on one bucket, and commands that run beside the server.

use std::path::Path;
use std::process::{Command, Output};
use std::time::Duration;

use relume::testing;
use relume_api::cameras::CameraConvention;
use relume_api::jobs::JobState;
use tempfile::TempDir;

use super::bucket::{ALL, Bucket};
use super::{copies, problem, server, shows, until};
use crate::server_process::Server;
use crate::service_support::{capture_zip, ended, small_job, trained};

/// A data directory with only the database of another one.
fn with_database_of(data: &Path) -> TempDir {
    let other = TempDir::new().unwrap();
    std::fs::copy(data.join("relume.db"), other.path().join("relume.db")).unwrap();
    other
}

/// The program, with a bucket in its environment variables.
fn relume(bucket: &Bucket) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
    command.envs(bucket.settings()).env("RELUME_ARTIFACTS", Bucket::url());
    command
}

/// Runs a program while this process serves the bucket.
async fn output(mut command: Command) -> Output {
    tokio::task::spawn_blocking(move || command.output().unwrap()).await.unwrap()
}

fn text(output: &Output) -> String {
    [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes)).concat()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_machine_with_only_the_database_serves_everything() {
    let bucket = Bucket::start().await;
    let first = server(&bucket, TempDir::new().unwrap(), |_| {}).await;
    let model = trained(first.client()).await.model.unwrap();
    let bytes = first.client().file(&model, "model.safetensors").await.unwrap();
    let data = first.stop().await.unwrap();

    // Negative control: without the bucket there are no artifacts.
    let plain = |config: &mut relume::server::ServerConfig| config.database = None;
    let alone = testing::spawn_with(with_database_of(data.path()), plain).await.unwrap();
    let refused = alone.client().file(&model, "model.safetensors").await.unwrap_err();
    assert_eq!(problem(refused), (500, "artifact-damaged".to_owned()));

    let second = server(&bucket, with_database_of(data.path()), |_| {}).await;
    let client = second.client();
    assert!(copies(second.data_dir()).is_empty());
    shows(client, &model).await.unwrap();
    assert_eq!(client.file(&model, "model.safetensors").await.unwrap(), bytes);
    client.viewer_stream(&model).await.unwrap();
    let capture = client.captures().await.unwrap().items.remove(0).id;
    assert_eq!(
        client.capture_photographs(&capture, CameraConvention::Opencv).await.unwrap().photographs.len(),
        8
    );
    let job = client.create_job(&small_job(&capture, 10, 5), None).await.unwrap();
    assert_eq!(ended(client, &job.id).await.state, JobState::Succeeded);
    let fetched = bucket.faults.count("GET attempts/");
    for _ in 0..5 {
        client.file(&model, "model.safetensors").await.unwrap();
    }
    assert_eq!(bucket.faults.count("GET attempts/"), fetched, "what is here is not fetched again");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_answered_upload_survives_the_loss_of_the_machine() {
    let bucket = Bucket::start().await;
    let data = TempDir::new().unwrap();
    let (command, path) = (relume(&bucket), data.path().to_owned());
    let start = tokio::task::spawn_blocking(move || Server::start_under(command, &path));
    let process = start.await.unwrap();
    let capture = process.client.upload_capture_bytes(capture_zip()).await.unwrap();
    process.kill();
    assert_eq!(bucket.keys().len(), 1);
    let folder = with_database_of(data.path());
    for name in ["relume.db-wal", "relume.db-shm"] {
        std::fs::copy(data.path().join(name), folder.path().join(name)).ok();
    }
    let next = server(&bucket, folder, |_| {}).await;
    assert_eq!(
        next.client()
            .capture_photographs(&capture.id, CameraConvention::Opencv)
            .await
            .unwrap()
            .photographs
            .len(),
        8
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn backup_fetches_objects_and_doctor_checks_the_bucket() {
    let bucket = Bucket::start().await;
    let first = server(&bucket, TempDir::new().unwrap(), |_| {}).await;
    let model = trained(first.client()).await.model.unwrap();
    let bytes = first.client().file(&model, "model.ply").await.unwrap();
    let data = with_database_of(first.stop().await.unwrap().path());

    let doctor = async || {
        let mut command = relume(&bucket);
        command.args(["doctor", "--device", "cpu", "--data-dir"]).arg(data.path());
        output(command).await
    };
    let sound = doctor().await;
    assert!(sound.status.success(), "{}", text(&sound));
    let out = TempDir::new().unwrap();
    let mut command = relume(&bucket);
    command.arg("backup").arg("--data-dir").arg(data.path()).arg(out.path().join("copy"));
    let made = output(command).await;
    assert!(made.status.success() && text(&made).contains("3 artifacts"), "{}", text(&made));
    assert!(copies(data.path()).is_empty(), "a backup fetches to where it is made");

    // A restored backup is complete without the bucket, which is unreachable by now.
    let key = bucket.keys().into_iter().find(|key| key.ends_with("model.ply")).unwrap();
    std::fs::write(bucket.folder().join(&key), "other bytes").unwrap();
    let damaged = doctor().await;
    assert!(
        !damaged.status.success() && text(&damaged).contains("damaged in the object store"),
        "{}",
        text(&damaged)
    );
    let restored = TempDir::new().unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
    command.arg("restore").arg("--data-dir").arg(restored.path()).arg(out.path().join("copy"));
    assert!(output(command).await.status.success());
    let plain = |config: &mut relume::server::ServerConfig| config.database = None;
    let alone = testing::spawn_with(restored, plain).await.unwrap();
    assert_eq!(alone.client().file(&model, "model.ply").await.unwrap(), bytes);
}

#[tokio::test(flavor = "multi_thread")]
async fn training_resumes_from_its_checkpoint_on_another_machine() {
    let bucket = Bucket::start().await;
    let first = server(&bucket, TempDir::new().unwrap(), |_| {}).await;
    let capture = first.client().upload_capture_bytes(capture_zip()).await.unwrap();
    let job = first.client().create_job(&small_job(&capture.id, 600, 20), None).await.unwrap();
    for _ in 0..600 {
        if first.client().job(&job.id).await.unwrap().progress.step > 40 {
            break;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let data = first.stop().await.unwrap();
    // The job does not restart from step 0 because its checkpoint is temporarily unreachable.
    let faults = &bucket.faults;
    "/checkpoint-".clone_into(&mut faults.refused_of.lock().unwrap());
    faults.set(&faults.refused, ALL);
    let second = server(&bucket, with_database_of(data.path()), |_| {}).await;
    let asked = || {
        faults
            .seen
            .lock()
            .unwrap()
            .iter()
            .filter(|s| s.starts_with("GET") && s.contains("/checkpoint-"))
            .count()
    };
    until("the checkpoint is asked for", || asked() > 3).await;
    tokio::time::sleep(Duration::from_secs(4)).await;
    faults.set(&faults.refused, 0);
    let mut warnings = 0;
    let done = second.client().wait(&job.id, |event| warnings += u32::from(event.kind == "warning")).await;
    let done = done.unwrap();
    assert_eq!((done.state, warnings), (JobState::Succeeded, 0));
    assert!(done.attempts > 2);
}
