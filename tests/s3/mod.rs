//! Artifacts in an object store: all operations work as with a folder, on any machine, and faults are
//! reported or repaired.

pub mod bucket;
mod faults;
mod machines;
mod redirects;

use std::path::Path;
use std::time::{Duration, SystemTime};

use relume::server::ServerConfig;
use relume::store::Store;
use relume::testing::{self, TestServer};
use relume_api::ModelId;
use relume_api::cameras::CameraConvention;
use relume_api::exports::NewExport;
use relume_api::jobs::JobState;
use relume_client::{Client, ClientError};
use serde_json::json;
use tempfile::TempDir;

use crate::service_support::{CaptureZip, capture_zip, ended, small_job, trained};
use bucket::{ALL, Bucket, keys_under};

/// A server whose artifacts are in a bucket, on a database in its directory.
async fn server(bucket: &Bucket, data: TempDir, change: impl FnOnce(&mut ServerConfig)) -> TestServer {
    let configure = |config: &mut ServerConfig| {
        config.database = None;
        config.artifacts = Some(bucket.place());
        change(config);
    };
    testing::spawn_with(data, configure).await.unwrap()
}

/// A new capture of at least `bytes`, with an incompressible file beside its photographs.
fn large_capture(bytes: usize) -> Vec<u8> {
    let mut state = 1u64;
    let noise = std::iter::repeat_with(|| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 56) as u8
    });
    let mut capture = CaptureZip::new(8, 32);
    capture.images.push(("note.bin".to_owned(), noise.take(bytes).collect()));
    capture.zip()
}

/// Whether the server returns the thumbnail of a model.
async fn shows(client: &Client, model: &ModelId) -> Result<(), ClientError> {
    client.thumbnail(model, "size=64").await.map(drop)
}

/// Keys of the local artifacts in a data directory, without unfinished uploads.
fn copies(data: &Path) -> Vec<String> {
    let all = keys_under(&data.join("artifacts"));
    all.into_iter().filter(|key| !key.starts_with("uploads/") && !key.starts_with("incoming/")).collect()
}

/// Waits until `is` returns true.
async fn until(what: &str, is: impl Fn() -> bool) {
    for _ in 0..1500 {
        if is() {
            return;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    panic!("it never came to this: {what}");
}

/// The problem of a refusal.
fn problem(error: ClientError) -> (u16, String) {
    let problem = error.problem().unwrap_or_else(|| panic!("{error}"));
    (problem.status, problem.kind.strip_prefix("urn:relume:problem:").unwrap().to_owned())
}

fn map() -> Vec<u8> {
    let mut bytes = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n".to_vec();
    bytes.extend([128, 128, 128, 129].repeat(4 * 8));
    bytes
}

#[tokio::test(flavor = "multi_thread")]
async fn files_are_in_the_bucket_from_the_answer_until_deletion() {
    let bucket = Bucket::start().await;
    let server = server(&bucket, TempDir::new().unwrap(), |_| {}).await;
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    let environment = client.upload_environment(map()).await.unwrap();
    let of = |family: &str| bucket.keys().iter().filter(|key| key.starts_with(family)).count();
    assert_eq!((of("captures/"), of("environments/"), bucket.keys().len()), (1, 1, 2));

    let job = client.create_job(&small_job(&capture.id, 30, 10), None).await.unwrap();
    until("a checkpoint is in the bucket", || bucket.keys().iter().any(|key| key.contains("/checkpoint-")))
        .await;
    let job = ended(client, &job.id).await;
    assert_eq!(job.state, JobState::Succeeded, "{:?}", job.error);
    let model = job.model.unwrap();
    shows(client, &model).await.unwrap();
    let files = client.model(&model).await.unwrap().files;
    let stored = keys_under(&bucket.folder().join("attempts"));
    assert_eq!(stored.len(), files.len(), "its files, and no checkpoint any more: {stored:?}");
    let request: NewExport = serde_json::from_value(json!({ "kind": "ply" })).unwrap();
    let export = client.create_export(&model, &request, None).await.unwrap();
    let export = client.wait_for_export(&export.id, |_| {}).await.unwrap();
    assert_eq!(client.export_file(&export.id).await.unwrap().len() as i64, export.file.unwrap().bytes);
    assert_eq!(of("exports/"), 1);
    let usage = client.usage().await.unwrap();
    assert_eq!((usage.captures.count, usage.models.count, usage.unreferenced_bytes), (1, 1, 0));

    client.delete_model(&model).await.unwrap();
    client.delete_capture(&capture.id, true).await.unwrap();
    client.delete_environment(&environment.id, false).await.unwrap();
    until("the bucket is empty", || bucket.keys().is_empty()).await;
    until("no copy is left", || copies(server.data_dir()).is_empty()).await;
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn resumable_uploads_stay_local_until_they_are_captures() {
    let bucket = Bucket::start().await;
    let server = server(&bucket, TempDir::new().unwrap(), |_| {}).await;
    let client = server.client();
    let archive = large_capture(11 << 20);
    let upload = client.begin_upload(archive.len() as u64).await.unwrap();
    client.send_piece(&upload, 0, archive[..100].to_vec()).await.unwrap();
    client.send_piece(&upload, 100, archive[100..].to_vec()).await.unwrap();
    assert!(bucket.keys().is_empty(), "{:?}", bucket.keys());
    let capture = client.capture_of_upload(&upload).await.unwrap();
    let folder = bucket.folder().join("captures");
    let keys = keys_under(&folder);
    assert_eq!((keys.len(), std::fs::read(folder.join(&keys[0])).unwrap() == archive), (1, true));
    assert_eq!(bucket.faults.count(&format!("PUT captures/{}?partNumber=", keys[0])), 3, "in parts");

    // A repeated upload takes no more space in the bucket, and replaces a lost object.
    std::fs::remove_file(folder.join(&keys[0])).unwrap();
    let again = client.upload_capture_bytes(archive.clone()).await.unwrap();
    assert_eq!(again.id, capture.id);
    assert!(std::fs::read(folder.join(&keys[0])).unwrap() == archive);
}

/// A size limit with which no copy is kept longer than it is used.
fn tiny(config: &mut ServerConfig, stays: Duration) {
    let place = config.artifacts.as_mut().unwrap();
    (place.cache_bytes, place.cache_min_age) = (1, stays);
}

#[tokio::test(flavor = "multi_thread")]
async fn with_a_tiny_cache_everything_is_served_and_nothing_kept() {
    let bucket = Bucket::start().await;
    let change = |config: &mut ServerConfig| tiny(config, Duration::from_secs(3));
    let server = server(&bucket, TempDir::new().unwrap(), change).await;
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let capture = client.captures().await.unwrap().items.remove(0).id;
    let names = ["model.safetensors", "model.ply"];
    let first = [client.file(&model, names[0]).await.unwrap(), client.file(&model, names[1]).await.unwrap()];
    for _ in 0..2 {
        until("all copies go", || copies(server.data_dir()).is_empty()).await;
        assert_eq!(bucket.keys().len(), 3, "the objects stay");
        for (name, bytes) in names.iter().zip(&first) {
            assert_eq!(client.file(&model, name).await.unwrap(), bytes);
        }
        shows(client, &model).await.unwrap();
        let photographs = client.capture_photographs(&capture, CameraConvention::Opencv).await.unwrap();
        assert_eq!(photographs.photographs.len(), 8);
        let picture = client.capture_photograph(&photographs.photographs[0], "width=16").await.unwrap();
        assert!(!picture.is_empty() && copies(server.data_dir()).len() == 3, "used lately");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn local_only_files_are_kept_until_they_are_in_the_bucket() {
    let (bucket, plain) = (Bucket::start().await, |config: &mut ServerConfig| config.database = None);
    let alone = testing::spawn_with(TempDir::new().unwrap(), plain).await.unwrap();
    let model = trained(alone.client()).await.model.unwrap();
    let bytes = alone.client().file(&model, "model.ply").await.unwrap();
    let data = alone.stop().await.unwrap();
    assert!(bucket.keys().is_empty(), "the control");

    // For any size limit, files that exist only on this machine are kept.
    let faults = &bucket.faults;
    "list-type".clone_into(&mut faults.refused_of.lock().unwrap());
    faults.set(&faults.refused, ALL);
    let first = server(&bucket, data, |config| tiny(config, Duration::ZERO)).await;
    until("the bucket is asked for each", || faults.count("HEAD ") >= 3).await;
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert_eq!((copies(first.data_dir()).len(), bucket.keys().len()), (3, 0));
    let data = first.stop().await.unwrap();

    faults.set(&faults.refused, 0);
    let second = server(&bucket, data, |_| {}).await;
    until("all is sent", || bucket.keys().len() == 3).await;
    for key in copies(second.data_dir()) {
        std::fs::remove_file(second.data_dir().join("artifacts").join(key)).unwrap();
    }
    assert_eq!(second.client().file(&model, "model.ply").await.unwrap(), bytes);
    shows(second.client(), &model).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn orphaned_objects_are_removed_after_a_day() {
    let bucket = Bucket::start().await;
    let server = server(&bucket, TempDir::new().unwrap(), |_| {}).await;
    let job = trained(server.client()).await;
    let data = server.stop().await.unwrap();
    let named = bucket.keys();
    let (left, unknown, foreign) =
        (format!("attempts/{}/9/checkpoint", job.id), format!("captures/{}", "0".repeat(64)), "notes/mine");
    for key in [&left, &unknown, foreign] {
        let path = bucket.folder().join(key);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, "left").unwrap();
    }
    let store = Store::open(data.path()).await.unwrap().with_artifacts(&bucket.place()).unwrap();
    let day = |days: u64| SystemTime::now() + Duration::from_secs(days * 24 * 3600 + 60);
    let settled = async |at| {
        let settled = store.reconcile_artifacts(at).await.unwrap();
        (settled.sent, settled.removed, settled.set_aside)
    };
    assert_eq!(settled(SystemTime::now()).await, (0, 0, 0), "another machine may be writing it");
    assert_eq!(settled(day(1)).await, (0, 1, 1));
    let now = bucket.keys();
    assert!(now.contains(&format!("orphans/{unknown}")) && !now.contains(&left) && !now.contains(&unknown));
    assert_eq!(settled(day(6)).await, (0, 0, 0));
    assert_eq!(settled(day(7)).await, (0, 1, 0));
    let mut expected = named;
    expected.push(foreign.to_owned());
    expected.sort();
    assert_eq!(bucket.keys(), expected, "what is named stays, and what is of others");
}
