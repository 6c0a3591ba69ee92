//! `relume worker` as a process: completed jobs, kills, stops, refusals.

use relume::server::ApiKeys;
use relume::testing::spawn_with;
use relume_api::jobs::JobState;
use tempfile::TempDir;

use crate::service_support::{ended, small_job, until};
use crate::workers::fleet::{
    Process, claimed, hello, model_hash, short_job, spawn_server, undisturbed, upload,
};

#[tokio::test(flavor = "multi_thread")]
async fn a_remote_worker_produces_the_same_bytes_as_the_server() {
    let expected = undisturbed(short_job).await;
    let (server, folder) = (spawn_server().await, TempDir::new().unwrap());
    let capture = upload(server.client()).await;
    let id = server.client().create_job(&short_job(&capture), None).await.unwrap().id;
    let waiting = server.client().job(&id).await.unwrap();
    assert_eq!(waiting.state, JobState::Queued, "the server trains nothing itself");
    let mut worker = Process::start(server.client(), folder.path(), &["--once", "--name", "rack 7"]);
    assert_eq!(worker.end().await.code(), Some(0));
    assert_eq!(model_hash(server.client(), &id).await, expected);
    let other = server.client().create_job(&small_job(&capture, 61, 10), None).await.unwrap().id;
    let mut worker = Process::start(server.client(), folder.path(), &["--once"]);
    assert_eq!(worker.end().await.code(), Some(0));
    assert_ne!(
        model_hash(server.client(), &other).await,
        expected,
        "the control: another job, another model"
    );
    let done = server.client().job(&id).await.unwrap();
    let workers = server.client().workers().await.unwrap().items;
    let rack = workers.iter().find(|worker| worker.name == "rack 7").unwrap();
    assert_eq!(done.worker.as_ref(), Some(&rack.id));
    assert!(done.figures.is_some() && rack.job.is_none() && !rack.in_server);
    let model = server.client().model(&done.model.unwrap()).await.unwrap();
    assert!(model.card["training_seconds"].is_number() && model.card["figures"].is_object());
}

#[tokio::test(flavor = "multi_thread")]
async fn an_idle_worker_with_once_exits_successfully() {
    let (server, folder) = (spawn_server().await, TempDir::new().unwrap());
    let mut worker = Process::start(server.client(), folder.path(), &["--once"]);
    assert_eq!(worker.end().await.code(), Some(0));
}

#[tokio::test(flavor = "multi_thread")]
async fn the_job_of_a_killed_worker_resumes_to_the_same_bytes() {
    let job = |capture: &_| small_job(capture, 400, 20);
    let expected = undisturbed(job).await;
    let (server, folder) = (spawn_server().await, TempDir::new().unwrap());
    let capture = upload(server.client()).await;
    let id = server.client().create_job(&job(&capture), None).await.unwrap().id;
    let worker = Process::start(server.client(), folder.path(), &[]);
    until(server.client(), &id, |job| job.progress.step >= 60).await;
    drop(worker);
    until(server.client(), &id, |job| job.state == JobState::Queued).await;
    let _second = Process::start(server.client(), folder.path(), &[]);
    assert_eq!(model_hash(server.client(), &id).await, expected);
    let attempts = server.client().job(&id).await.unwrap().attempts;
    assert_eq!(attempts, 2, "it was not finished before the kill");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_terminated_worker_releases_its_job_with_a_checkpoint() {
    let job = |capture: &_| small_job(capture, 2000, 1000);
    let (server, folder) = (spawn_server().await, TempDir::new().unwrap());
    let capture = upload(server.client()).await;
    let id = server.client().create_job(&job(&capture), None).await.unwrap().id;
    let mut worker = Process::start(server.client(), folder.path(), &[]);
    until(server.client(), &id, |job| job.progress.step >= 30).await;
    worker.terminate();
    assert_eq!(worker.end().await.code(), Some(75));
    let waiting = server.client().job(&id).await.unwrap();
    assert_eq!(waiting.state, JobState::Queued);
    let next = claimed(server.client(), &hello("worker-2")).await.task.unwrap();
    assert!(next.checkpoint_step.unwrap() >= 30 && next.attempt == 2, "{next:?}");
    server.client().cancel_job(&id).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn cancelling_a_job_stops_its_remote_worker() {
    let (server, folder) = (spawn_server().await, TempDir::new().unwrap());
    let capture = upload(server.client()).await;
    let id = server.client().create_job(&small_job(&capture, 100_000, 50_000), None).await.unwrap().id;
    let _worker = Process::start(server.client(), folder.path(), &[]);
    until(server.client(), &id, |job| job.progress.step >= 5).await;
    server.client().cancel_job(&id).await.unwrap();
    assert_eq!(ended(server.client(), &id).await.state, JobState::Cancelled);
}

#[tokio::test(flavor = "multi_thread")]
async fn worker_exit_codes_report_failed_jobs_and_refused_keys() {
    let (server, folder) = (spawn_server().await, TempDir::new().unwrap());
    let capture = upload(server.client()).await;
    let archive = std::fs::read_dir(server.data_dir().join("artifacts/captures")).unwrap().next().unwrap();
    std::fs::write(archive.unwrap().path(), "no longer an archive").unwrap();
    let id = server.client().create_job(&short_job(&capture), None).await.unwrap().id;
    let mut worker = Process::start(server.client(), folder.path(), &["--once"]);
    let code = worker.end().await.code();
    let done = ended(server.client(), &id).await;
    assert_eq!((done.state, code), (JobState::Failed, Some(3)), "{done:?}");
    let key = folder.path().join("key");
    std::fs::write(&key, "no-such-key-0123456789\n").unwrap();
    let keys = ApiKeys::new(["a-real-key-0123456789"]);
    let locked = spawn_with(TempDir::new().unwrap(), |config| config.api_keys = keys).await.unwrap();
    let mut refused = Process::start(locked.client(), folder.path(), &["--key-file", key.to_str().unwrap()]);
    assert_eq!(refused.end().await.code(), Some(1));
}
