//! Deletion removes a resource and its files; resources that others need are kept.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use relume::jobs::ManualClock;
use relume::server::RetentionPace;
use relume::store::{Deletion, Retention, StoreError};
use relume::testing::{self, TestServer};
use relume_api::jobs::{JobState, NewJob};
use relume_api::{CaptureId, Problem, ResourceKind, ResourceName, TenantId};
use relume_client::{Client, ClientError};
use relume_spec::training::{KnownLight, LightExposure};
use reqwest::Method;
use tempfile::TempDir;

use crate::server_process::Server;
use crate::service_support::{
    CaptureZip, capture_zip, ended, files_under, open_store, raw_pool, small_job, trained, until,
};

/// More steps than any test needs.
const ENDLESS: u32 = 1_000_000;

/// A grey map of 32 x 16 pixels, in Radiance format without run lengths.
fn hdr() -> Vec<u8> {
    let mut bytes = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 16 +X 32\n".to_vec();
    bytes.extend([128, 128, 128, 129].repeat(32 * 16));
    bytes
}

/// The names of the artifacts.
fn artifacts(data: &Path) -> Vec<String> {
    files_under(&data.join("artifacts")).into_iter().map(|(name, _)| name).collect()
}

/// Waits until there are `count` artifacts.
async fn until_artifacts(data: &Path, count: usize) {
    for _ in 0..1500 {
        if artifacts(data).len() == count {
            return;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    panic!("{count} files were expected: {:?}", artifacts(data));
}

/// The status of a refusal.
fn refused<T: std::fmt::Debug>(answer: Result<T, ClientError>) -> Problem {
    let error = answer.expect_err("it was to be refused");
    error.problem().unwrap_or_else(|| panic!("{error}")).clone()
}

/// Number of rows of every table with resources.
async fn rows(data: &Path) -> Vec<i64> {
    let pool = raw_pool(data).await;
    let mut counts = Vec::new();
    for count in [
        "SELECT COUNT(*) FROM captures",
        "SELECT COUNT(*) FROM environments",
        "SELECT COUNT(*) FROM jobs",
        "SELECT COUNT(*) FROM events",
        "SELECT COUNT(*) FROM models",
        "SELECT COUNT(*) FROM model_files",
    ] {
        counts.push(sqlx::query_scalar(count).fetch_one(&pool).await.unwrap());
    }
    pool.close().await;
    counts
}

async fn status(server: &TestServer, path: &str) -> u16 {
    server.client().request(Method::GET, path).unwrap().send().await.unwrap().status().as_u16()
}

#[tokio::test(flavor = "multi_thread")]
async fn deleted_resources_answer_404_and_leave_no_files_or_rows() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let job = trained(client).await;
    let (model, map) = (job.model.clone().unwrap(), client.upload_environment(hdr()).await.unwrap());
    let of_model = format!("/v1/models/{model}");
    let asked =
        ["", "/card", "/files/model.safetensors", "/thumbnail?size=16"].map(|p| format!("{of_model}{p}"));
    let lit = format!("{of_model}/thumbnail?size=16&env={}", map.id);
    // From now on the device has the model and the light in its cache.
    for path in asked.iter().chain([&lit]) {
        assert_eq!(status(&server, path).await, 200, "{path}");
    }

    client.delete_environment(&map.id, false).await.unwrap();
    assert_eq!(status(&server, &lit).await, 422);
    client.delete_model(&model).await.unwrap();
    for path in &asked {
        assert_eq!(status(&server, path).await, 404, "{path}");
    }
    let record = client.job(&job.id).await.unwrap();
    assert_eq!((record.state, &record.model), (JobState::Succeeded, &Some(model.clone())));
    assert!(record.model_deleted_at.is_some(), "the job says that its model is gone");
    assert!(job.model_deleted_at.is_none());
    until_artifacts(server.data_dir(), 1).await;

    client.delete_job(&job.id, false).await.unwrap();
    client.delete_capture(&job.capture, false).await.unwrap();
    let again = [
        client.delete_environment(&map.id, true).await,
        client.delete_model(&model).await,
        client.delete_job(&job.id, true).await,
        client.delete_capture(&job.capture, true).await,
        client.delete_capture(&"never-was".into(), false).await,
    ];
    for answer in again {
        let problem = refused(answer);
        assert_eq!((problem.status, problem.kind.as_str()), (404, "urn:relume:problem:not-found"));
    }
    assert!(
        client.captures().await.unwrap().items.is_empty() && client.jobs().await.unwrap().items.is_empty()
    );
    assert_eq!(status(&server, &format!("/v1/jobs/{}/events", job.id)).await, 404);
    until_artifacts(server.data_dir(), 0).await;
    let data = server.stop().await.unwrap();
    assert_eq!(rows(data.path()).await, [0; 6], "nor is anything left in the database");
    assert!(!data.path().join("artifacts/attempts").join(job.id.as_str()).exists());
}

#[tokio::test(flavor = "multi_thread")]
async fn deleting_a_job_keeps_its_model() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let job = trained(client).await;
    let model = job.model.unwrap();
    client.delete_job(&job.id, false).await.unwrap();
    client.delete_capture(&job.capture, false).await.unwrap();
    until_artifacts(server.data_dir(), 2).await;
    // A restart also removes the files of deleted resources.
    let data = server.stop().await.unwrap();
    let server = testing::spawn_with(data, |_| {}).await.unwrap();
    let client = server.client();
    assert_eq!(client.model(&model).await.unwrap().summary.job, job.id);
    client.file(&model, "model.safetensors").await.unwrap();
    client.thumbnail(&model, "size=16").await.unwrap();
    client.delete_model(&model).await.unwrap();
    until_artifacts(server.data_dir(), 0).await;
    assert_eq!(rows(server.stop().await.unwrap().path()).await, [0; 6]);
}

#[tokio::test(flavor = "multi_thread")]
async fn delete_of_a_used_capture_answers_409_or_cascades_to_jobs() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    let running = client.create_job(&small_job(&capture.id, ENDLESS, 1000), None).await.unwrap();
    let queued = client.create_job(&small_job(&capture.id, 5, 5), None).await.unwrap();
    until(client, &running.id, |job| job.progress.step > 0).await;

    let problem = refused(client.delete_capture(&capture.id, false).await);
    assert_eq!((problem.status, problem.kind.as_str()), (409, "urn:relume:problem:in-use"));
    let names = [&running.id, &queued.id].map(|id| ResourceName::new(ResourceKind::Job, id.as_str()));
    assert_eq!(problem.needed_by, names);
    let problem = refused(client.delete_job(&running.id, false).await);
    assert_eq!((problem.status, problem.needed_by), (409, vec![names[0].clone()]));
    assert_eq!(client.job(&running.id).await.unwrap().state, JobState::Running, "a refusal changes nothing");

    let odd = format!("/v1/captures/{}?cascade=maybe", capture.id);
    let odd = client.request(Method::DELETE, &odd).unwrap().send().await.unwrap();
    let problem: Problem = serde_json::from_slice(&odd.bytes().await.unwrap()).unwrap();
    assert_eq!((problem.status, problem.errors[0].pointer.as_str()), (422, "query/cascade"));
    client.delete_capture(&capture.id, true).await.unwrap();
    for id in [&running.id, &queued.id] {
        assert_eq!(refused(client.job(id).await).status, 404);
    }
    // The same content is now another capture, whose file remains when the deleted one is cleaned up.
    let other = client.upload_capture_bytes(capture_zip()).await.unwrap();
    assert_ne!(other.id, capture.id);
    let next = client.create_job(&small_job(&other.id, 5, 5), None).await.unwrap();
    assert_eq!(ended(client, &next.id).await.state, JobState::Succeeded, "the device is free");
    until_artifacts(server.data_dir(), 3).await;
    assert_eq!(client.jobs().await.unwrap().items.len(), 1);
    // The next start completes the cleanup, even if this server has not finished it.
    let server = testing::spawn_with(server.stop().await.unwrap(), |_| {}).await.unwrap();
    assert_eq!(rows(server.stop().await.unwrap().path()).await[..3], [1, 0, 1]);
}

#[tokio::test(flavor = "multi_thread")]
async fn inputs_of_a_retryable_job_cannot_be_deleted() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    let map = client.upload_environment(hdr()).await.unwrap();
    let mut job: NewJob = small_job(&capture.id, ENDLESS, 1000);
    let environment = map.id.to_string();
    job.overrides.light =
        Some(KnownLight { environment, rotation_deg: 0.0, exposure_ev: LightExposure::default() });
    let job = client.create_job(&job, None).await.unwrap();
    until(client, &job.id, |job| job.progress.step > 0).await;
    client.cancel_job(&job.id).await.unwrap();
    assert_eq!(ended(client, &job.id).await.state, JobState::Cancelled);
    let named = [ResourceName::new(ResourceKind::Job, job.id.as_str())];
    assert_eq!(
        refused(client.delete_capture(&capture.id, false).await).needed_by,
        named,
        "it may be retried"
    );
    assert_eq!(refused(client.delete_environment(&map.id, false).await).needed_by, named);
    client.delete_environment(&map.id, true).await.unwrap();
    assert_eq!(refused(client.retry_job(&job.id).await).status, 404);
    client.delete_capture(&capture.id, false).await.unwrap();
    until_artifacts(server.data_dir(), 0).await;
}

/// A data directory with one capture, without a server.
async fn with_capture() -> (TempDir, CaptureId) {
    let server = testing::spawn().await.unwrap();
    let capture = server.client().upload_capture_bytes(capture_zip()).await.unwrap().id;
    (server.stop().await.unwrap(), capture)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_on_a_just_deleted_capture_is_refused() {
    let (data, capture) = with_capture().await;
    let store = open_store(data.path()).await;
    let job =
        |request| relume::store::JobRecord::queued(TenantId::of_operator(), "job".into(), request, 1, 0);
    let name = ResourceName::new(ResourceKind::Capture, capture.as_str());
    assert_eq!(store.delete(&TenantId::of_operator(), &name, false, 1).await.unwrap(), Deletion::Done);
    let request = NewJob { capture, ..NewJob::default() };
    let submitted = store.submit_job(&job(request), None, |_, _| String::new()).await;
    assert!(matches!(submitted, Err(StoreError::Deleted(it)) if it == name));
    store.close().await;
    assert_eq!(rows(data.path()).await[2], 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn startup_completes_a_deletion_interrupted_by_a_crash() {
    let (data, capture) = with_capture().await;
    let store = open_store(data.path()).await;
    store
        .delete(
            &TenantId::of_operator(),
            &ResourceName::new(ResourceKind::Capture, capture.as_str()),
            false,
            1,
        )
        .await
        .unwrap();
    store.close().await;
    assert_eq!(artifacts(data.path()).len(), 1, "marked and not swept");
    let server = testing::spawn_with(data, |_| {}).await.unwrap();
    server.client().captures().await.unwrap();
    assert!(artifacts(server.data_dir()).is_empty(), "neither there nor set aside");
    assert_eq!(rows(server.stop().await.unwrap().path()).await, [0; 6]);
}

/// Deletes all resources; a kill interrupts this.
async fn delete_everything(client: &Client) -> Result<(), ClientError> {
    for capture in client.captures().await?.items {
        client.delete_capture(&capture.id, true).await?;
    }
    for model in client.models().await?.items {
        client.delete_model(&model.id).await?;
    }
    for job in client.jobs().await?.items {
        client.delete_job(&job.id, true).await?;
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn kills_during_deletion_leave_no_files_or_rows() {
    let data = TempDir::new().unwrap();
    for delay in [0, 5, 15, 40, 100, 250] {
        let server = Server::start(data.path());
        let client = &server.client;
        trained(client).await;
        let other = client.upload_capture_bytes(CaptureZip::new(9, 32).zip()).await.unwrap();
        let job = client.create_job(&small_job(&other.id, ENDLESS, 5), None).await.unwrap();
        until(client, &job.id, |job| job.progress.step > 5).await;
        let deleting = client.clone();
        let deleting = tokio::spawn(async move { delete_everything(&deleting).await });
        tokio::time::sleep(Duration::from_millis(delay)).await;
        server.kill();
        deleting.await.unwrap().ok();
        // The next server completes the deletions, and all other resources are intact.
        let server = Server::start(data.path());
        for model in server.client.models().await.unwrap().items {
            server.client.file(&model.id, "model.safetensors").await.unwrap();
        }
        delete_everything(&server.client).await.unwrap();
        until_artifacts(data.path(), 0).await;
        server.kill();
    }
    let server = testing::spawn_with(data, |_| {}).await.unwrap();
    assert_eq!(rows(server.stop().await.unwrap().path()).await, [0; 6]);
}

const DAY: Duration = Duration::from_secs(24 * 3600);

#[tokio::test(flavor = "multi_thread")]
async fn retention_deletes_old_resources_that_are_not_in_use() {
    let clock = Arc::new(ManualClock::default());
    clock.advance(1000 * DAY);
    let with = |days: [Option<u32>; 3]| {
        let clock = clock.clone();
        move |config: &mut relume::server::ServerConfig| {
            let [jobs, captures, models] = days.map(|days| days.map(|days| days * DAY));
            config.retention = Retention { jobs, captures, models, exports: None };
            config.retention_pace = RetentionPace::UNLIMITED;
            config.clock = clock;
        }
    };
    let server = testing::spawn_with(TempDir::new().unwrap(), with([None; 3])).await.unwrap();
    let client = server.client();
    let done = trained(client).await;
    let needed = client.upload_capture_bytes(CaptureZip::new(9, 32).zip()).await.unwrap();
    let cancelled = client.create_job(&small_job(&needed.id, ENDLESS, 1000), None).await.unwrap();
    client.cancel_job(&cancelled.id).await.unwrap();
    ended(client, &cancelled.id).await;
    // Numbers of captures, jobs and models after a server with this retention has run its garbage collection.
    let after = async |server: TestServer, days: [Option<u32>; 3]| {
        let data = server.stop().await.unwrap();
        let server = testing::spawn_with(data, with(days)).await.unwrap();
        // The stop makes sure that the first garbage collection has ended.
        let data = server.stop().await.unwrap();
        let server = testing::spawn_with(data, with([None; 3])).await.unwrap();
        let client = server.client();
        let captures = client.captures().await.unwrap().items.len();
        let counts =
            [captures, client.jobs().await.unwrap().items.len(), client.models().await.unwrap().items.len()];
        (server, counts)
    };
    clock.advance(9 * DAY);
    let (server, counts) = after(server, [Some(10); 3]).await;
    assert_eq!(counts, [2, 2, 1], "nothing is old enough");
    clock.advance(2 * DAY);
    let (server, counts) = after(server, [None; 3]).await;
    assert_eq!(counts, [2, 2, 1], "without rules everything is kept");
    let (server, counts) = after(server, [None, Some(10), None]).await;
    assert_eq!(counts, [1, 2, 1], "the cancelled job may be run again");
    assert_eq!(server.client().capture(&needed.id).await.unwrap().id, needed.id);
    let (server, counts) = after(server, [Some(10), None, None]).await;
    assert_eq!(counts, [1, 0, 1], "a model does not need its job");
    server.client().file(&done.model.unwrap(), "model.ply").await.unwrap();
    let (server, counts) = after(server, [None, Some(10), Some(10)]).await;
    assert_eq!(counts, [0, 0, 0]);
    until_artifacts(server.data_dir(), 0).await;
}
