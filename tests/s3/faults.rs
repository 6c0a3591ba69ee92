//! Faults between a server and its object store.

use std::time::Duration;

use relume::testing::TestServer;
use relume_api::ModelId;
use relume_api::captures::{CaptureState, CaptureSummary};
use relume_api::exports::NewExport;
use relume_api::jobs::JobState;
use reqwest::Method;
use tempfile::TempDir;

use super::bucket::{ALL, Bucket};
use super::{copies, large_capture, problem, server};
use crate::service_support::{capture_zip, ended, files_under, small_job, trained};

/// A server without local copies, and one of its models.
async fn with_nothing_here(bucket: &Bucket) -> (TestServer, ModelId) {
    let first = server(bucket, TempDir::new().unwrap(), |_| {}).await;
    let model = trained(first.client()).await.model.unwrap();
    let data = first.stop().await.unwrap();
    std::fs::remove_dir_all(data.path().join("artifacts")).unwrap();
    let next = server(bucket, data, |_| {}).await;
    // By then its reconciliation has listed the bucket.
    super::until("the bucket is listed", || bucket.faults.count("GET /bucket?list-type=2") > 1).await;
    (next, model)
}

async fn ready(server: &TestServer) -> u16 {
    server.client().request(Method::GET, "/readyz").unwrap().send().await.unwrap().status().as_u16()
}

#[tokio::test(flavor = "multi_thread")]
async fn an_unreachable_object_store_answers_503_and_stores_nothing() {
    let bucket = Bucket::start().await;
    let server = server(&bucket, TempDir::new().unwrap(), |_| {}).await;
    let (client, faults) = (server.client(), &bucket.faults);
    assert_eq!(ready(&server).await, 200);
    faults.set(&faults.refused, ALL);
    let answer = client.request(Method::POST, "/v1/captures").unwrap();
    let answer = answer.header("content-type", "application/zip").body(capture_zip()).send().await.unwrap();
    assert_eq!((answer.status().as_u16(), answer.headers()["retry-after"].to_str().unwrap()), (503, "5"));
    let refused = client.upload_capture_bytes(capture_zip()).await.unwrap_err();
    assert_eq!(problem(refused), (503, "artifacts-unreachable".to_owned()));
    assert_eq!(ready(&server).await, 503);
    assert!(client.captures().await.unwrap().items.is_empty() && bucket.keys().is_empty());
    let left = files_under(&server.data_dir().join("artifacts"));
    assert!(left.is_empty(), "{left:?}");

    // A few refusals have no effect.
    faults.set(&faults.refused, 2);
    client.upload_capture_bytes(capture_zip()).await.unwrap();
    assert_eq!((bucket.keys().len(), ready(&server).await), (1, 200));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_interrupted_put_to_the_object_store_is_retried() {
    let bucket = Bucket::start().await;
    let server = server(&bucket, TempDir::new().unwrap(), |_| {}).await;
    bucket.faults.set(&bucket.faults.unanswered, 2);
    let archive = large_capture(11 << 20);
    server.client().upload_capture_bytes(archive.clone()).await.unwrap();
    let key = bucket.keys().remove(0);
    assert!(std::fs::read(bucket.folder().join(key)).unwrap() == archive);
}

#[tokio::test(flavor = "multi_thread")]
async fn truncated_objects_are_resumed_and_corrupt_ones_fetched_again() {
    let bucket = Bucket::start().await;
    let (server, model) = with_nothing_here(&bucket).await;
    let (client, faults, name) = (server.client(), &bucket.faults, "model.safetensors");
    let stored = bucket.keys().into_iter().find(|key| key.ends_with(name)).unwrap();
    let stored = std::fs::read(bucket.folder().join(stored)).unwrap();
    let forget = || {
        for key in copies(server.data_dir()) {
            std::fs::remove_file(server.data_dir().join("artifacts").join(key)).unwrap();
        }
    };
    faults.set(&faults.cut, 3);
    assert_eq!(client.file(&model, name).await.unwrap(), stored);
    assert_eq!(faults.cut.load(std::sync::atomic::Ordering::SeqCst), 0, "it was cut off");

    forget();
    faults.set(&faults.flipped, 1);
    assert_eq!(client.file(&model, name).await.unwrap(), stored);

    forget();
    faults.set(&faults.flipped, 2);
    let refused = client.file(&model, name).await.unwrap_err();
    assert_eq!(problem(refused), (500, "artifact-damaged".to_owned()));
    let left = files_under(&server.data_dir().join("artifacts"));
    assert!(left.is_empty(), "{left:?}");
    assert_eq!(client.file(&model, name).await.unwrap(), stored);

    // A damaged local copy is not the stored object.
    let copy = server.data_dir().join("artifacts").join(copies(server.data_dir()).remove(0));
    std::fs::write(&copy, "other bytes").unwrap();
    assert_eq!(client.file(&model, name).await.unwrap(), stored);
    assert!(std::fs::read(copy).unwrap() == stored);
}

#[tokio::test(flavor = "multi_thread")]
async fn concurrent_requests_for_an_object_fetch_it_once() {
    let bucket = Bucket::start().await;
    let (server, model) = with_nothing_here(&bucket).await;
    bucket.faults.slow.store(200, std::sync::atomic::Ordering::SeqCst);
    let before = bucket.faults.count("GET attempts/");
    let ask = || server.client().file(&model, "model.ply");
    let files = futures::future::join_all((0..8).map(|_| ask())).await;
    assert!(files.into_iter().all(|file| file.is_ok()));
    assert_eq!(bucket.faults.count("GET attempts/"), before + 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_waits_for_an_unreachable_object_store() {
    let bucket = Bucket::start().await;
    let change = |config: &mut relume::server::ServerConfig| config.lease.max_idle_attempts = 1;
    let first = server(&bucket, TempDir::new().unwrap(), |_| {}).await;
    let capture = first.client().upload_capture_bytes(capture_zip()).await.unwrap();
    let data = first.stop().await.unwrap();
    std::fs::remove_dir_all(data.path().join("artifacts")).unwrap();
    let server = server(&bucket, data, change).await;
    let (client, faults) = (server.client(), &bucket.faults);
    faults.set(&faults.refused, ALL);
    let job = client.create_job(&small_job(&capture.id, 10, 5), None).await.unwrap();
    tokio::time::sleep(Duration::from_secs(4)).await;
    let waiting = client.job(&job.id).await.unwrap();
    assert!(!waiting.state.is_terminal() && waiting.attempts > 1, "{waiting:?}");
    assert!(waiting.attempts < 10, "it is not tried all the time: {}", waiting.attempts);
    faults.set(&faults.refused, 0);
    let job = ended(client, &job.id).await;
    assert_eq!(job.state, JobState::Succeeded, "{:?}", job.error);
}

#[tokio::test(flavor = "multi_thread")]
async fn accepted_work_is_completed_once_the_object_store_returns() {
    let bucket = Bucket::start().await;
    let server = server(&bucket, TempDir::new().unwrap(), |_| {}).await;
    let (client, faults) = (server.client(), &bucket.faults);
    let model = trained(client).await.model.unwrap();
    faults.set(&faults.refused, ALL);
    let answer = client.request(Method::POST, "/v1/captures").unwrap().header("prefer", "respond-async");
    let answer =
        answer.header("content-type", "application/zip").body(large_capture(10)).send().await.unwrap();
    assert_eq!(answer.status().as_u16(), 202);
    let promised: CaptureSummary = answer.json().await.unwrap();
    let request: NewExport = serde_json::from_value(serde_json::json!({ "kind": "ply" })).unwrap();
    let export = client.create_export(&model, &request, None).await.unwrap();
    tokio::time::sleep(Duration::from_secs(3)).await;
    assert_eq!(client.capture(&promised.id).await.unwrap().state, CaptureState::Validating);
    assert!(!client.export(&export.id).await.unwrap().state.is_terminal());
    faults.set(&faults.refused, 0);
    let export = client.wait_for_export(&export.id, |_| {}).await.unwrap();
    assert_eq!(client.export_file(&export.id).await.unwrap().len() as i64, export.file.unwrap().bytes);
    for _ in 0..600 {
        if client.capture(&promised.id).await.unwrap().state == CaptureState::Ready {
            return;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    panic!("the capture was never made");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_deletion_waits_for_an_unreachable_object_store() {
    let bucket = Bucket::start().await;
    let server = server(&bucket, TempDir::new().unwrap(), |_| {}).await;
    let (client, faults) = (server.client(), &bucket.faults);
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    faults.set(&faults.refused, ALL);
    client.delete_capture(&capture.id, false).await.unwrap();
    tokio::time::sleep(Duration::from_millis(1500)).await;
    assert_eq!(bucket.keys().len(), 1);
    faults.set(&faults.refused, 0);
    // The bucket was unreachable for this reconciliation. A restart triggers the next one soonest.
    let data = server.stop().await.unwrap();
    let _next = super::server(&bucket, data, |_| {}).await;
    super::until("the object is gone", || bucket.keys().is_empty()).await;
}
