//! A disk that fails, refuses writes or is slow: every request gets an answer with the reason, nothing
//! incomplete is published, and the server continues when the disk works again.

mod disk;

use relume_api::cameras::CameraConvention;
use relume_api::jobs::{JobState, JobView};
use relume_api::{ModelId, Problem};
use relume_client::{Client, ClientError};
use reqwest::Method;

use crate::service_support::{CaptureZip, capture_zip, ended, small_job, trained, until};
use disk::FaultyDisk;
use relume_fixtures::small_set::{blender, gzip, tar};

const EIO: i32 = 5;
const EROFS: i32 = 30;

/// A grey map of 8 x 4 pixels.
fn map() -> Vec<u8> {
    let mut bytes = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n".to_vec();
    bytes.extend([128, 128, 128, 129].repeat(4 * 8));
    bytes
}

/// Checks that a problem is the one that errors.md documents for a disk failure.
fn is_clear(problem: &Problem) {
    let kind = problem.kind.strip_prefix("urn:relume:problem:").unwrap();
    let documented = include_str!("../../docs/errors.md").contains(&format!("`{kind}` | {}", problem.status));
    assert!(documented, "{problem:?} is not documented");
    assert_eq!((problem.status, kind), (500, "storage-failed"), "{problem:?}");
    assert!(
        !problem.detail.clone().unwrap_or_default().contains('/'),
        "{problem:?} tells of the server's disk"
    );
}

fn refused<T: std::fmt::Debug>(answer: Result<T, ClientError>) {
    let error = answer.expect_err("the disk fails");
    is_clear(error.problem().unwrap_or_else(|| panic!("{error}")));
}

async fn is_ready(client: &Client) -> bool {
    client.request(Method::GET, "/healthz").unwrap().send().await.unwrap().status().is_success()
}

/// A capture that was not sent before.
fn another(count: u8) -> Vec<u8> {
    let mut capture = CaptureZip::new(8, 32);
    capture.images.push(("note.txt".to_owned(), vec![count]));
    capture.zip()
}

fn code(job: &JobView) -> Option<&str> {
    job.error.as_ref().map(|error| error.code.as_str())
}

#[tokio::test(flavor = "multi_thread")]
async fn failed_writes_answer_with_a_problem_and_publish_nothing() {
    let disk = FaultyDisk::start();
    let client = &disk.server.client;
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    let upload = client.begin_upload(another(1).len() as u64).await.unwrap();
    for (round, errno) in [EIO, EROFS].into_iter().enumerate() {
        disk.fails("write", errno, 0);
        refused(client.upload_capture_bytes(another(9)).await);
        refused(client.upload_environment(map()).await);
        refused(client.begin_upload(100).await);
        refused(client.send_piece(&upload, 0, another(1)[..50].to_vec()).await);
        assert_eq!(client.upload(&upload).await.unwrap().offset, 0, "nothing of it counts");
        // The training continues without checkpoints, and its model cannot be stored.
        let job = client.create_job(&small_job(&capture.id, 12, 5), None).await.unwrap();
        let job = ended(client, &job.id).await;
        assert_eq!((job.state, code(&job)), (JobState::Failed, Some("storage_failed")));
        assert_eq!(client.models().await.unwrap().items.len(), round, "nothing was published");
        assert_eq!(client.captures().await.unwrap().items.len(), 1);
        assert!(client.environments().await.unwrap().uploaded.items.is_empty());
        assert!(is_ready(client).await);

        disk.mends();
        let again = client.retry_job(&job.id).await.unwrap();
        assert_eq!(ended(client, &again.id).await.state, JobState::Succeeded, "and it goes on");
    }
    client.send_piece(&upload, 0, another(1)).await.unwrap();
    client.capture_of_upload(&upload).await.unwrap();
    client.upload_environment(map()).await.unwrap();
    disk.ends_sound().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn temporary_write_failures_cost_only_checkpoints() {
    let disk = FaultyDisk::start();
    let client = &disk.server.client;
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    let job = client.create_job(&small_job(&capture.id, 3000, 10), None).await.unwrap();
    until(client, &job.id, |job| job.progress.step > 20).await;
    disk.fails("write", EIO, 0);
    let failing = client.job(&job.id).await.unwrap().progress.step;
    until(client, &job.id, |job| job.progress.step > failing + 30).await;
    disk.mends();
    let mut warnings = 0;
    let done = client.wait(&job.id, |event| warnings += u32::from(event.kind == "warning")).await.unwrap();
    assert_eq!((done.state, done.attempts), (JobState::Succeeded, 1));
    assert!(warnings > 0, "checkpoints that failed are told of");
    disk.ends_sound().await;
}

/// Requests that read a model's files.
async fn reads(client: &Client, model: &ModelId) -> Vec<Result<(), ClientError>> {
    let camera = serde_json::json!({ "look_at": { "eye": [3, 0, 1], "target": [0, 0, 0], "fov_y_deg": 40 } });
    let body = serde_json::json!({ "camera": camera, "width": 16, "height": 16 });
    let render = client.request(Method::POST, &format!("/v1/models/{model}/render")).unwrap().json(&body);
    let render = render.send().await.unwrap();
    let status = render.status();
    let bytes = render.bytes().await.unwrap();
    let render = match serde_json::from_slice::<Problem>(&bytes) {
        Ok(problem) => Err(ClientError::Problem(Box::new(problem))),
        Err(_) => {
            assert!(status.is_success());
            Ok(())
        }
    };
    vec![
        client.file(model, "model.safetensors").await.map(drop),
        client.file(model, "model.ply").await.map(drop),
        client.thumbnail(model, "size=16").await.map(drop),
        render,
    ]
}

#[tokio::test(flavor = "multi_thread")]
async fn failed_reads_answer_with_a_problem_and_not_truncated_data() {
    let disk = FaultyDisk::start();
    let client = &disk.server.client;
    let job = trained(client).await;
    let model = job.model.unwrap();
    // The cache is still empty.
    disk.fails("read", EIO, 0);
    for answer in reads(client, &model).await {
        refused(answer);
    }
    // The server reads an upload again before it stores the capture. A disk failure at any byte is not
    // reported as a damaged archive.
    for byte in [0, 1] {
        disk.fails_behind(byte, EIO);
        for archive in [another(3), tar(&blender()), gzip(&tar(&blender()))] {
            refused(client.upload_capture_bytes(archive.clone()).await);
            refused(client.validate_capture_bytes(archive).await);
        }
    }
    disk.fails("read", EIO, 0);
    refused(client.upload_environment(map()).await);
    refused(client.capture_cameras(&job.capture, CameraConvention::Opengl).await);
    let failed = client.create_job(&small_job(&job.capture, 5, 5), None).await.unwrap();
    let failed = ended(client, &failed.id).await;
    // The hash of the capture is already verified, so the fault occurs in the import.
    assert_eq!((failed.state, code(&failed)), (JobState::Failed, Some("capture_io")));
    disk.mends();
    for answer in reads(client, &model).await {
        answer.unwrap();
    }
    // The hash of the file is already verified, so the fault occurs while the answer is sent. The client must
    // detect the truncated answer.
    disk.fails("read", EIO, 0);
    let cut = client.file(&model, "model.safetensors").await;
    assert!(cut.is_err(), "an answer that cannot be read is taken for whole");
    disk.mends();
    client.file(&model, "model.safetensors").await.unwrap();
    let again = client.retry_job(&failed.id).await.unwrap();
    assert_eq!(ended(client, &again.id).await.state, JobState::Succeeded);
    disk.ends_sound().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_slow_disk_does_not_block_other_requests() {
    let disk = FaultyDisk::start();
    let client = &disk.server.client;
    disk.fails("both", 0, 40);
    let uploads = (0..8).map(|count| {
        let client = client.clone();
        tokio::spawn(
            async move { client.upload_capture_bytes(another(count)).await.map(|capture| capture.id) },
        )
    });
    let uploads: Vec<_> = uploads.collect();
    let mut answered = 0;
    while uploads.iter().any(|upload| !upload.is_finished()) {
        assert!(is_ready(client).await);
        client.captures().await.unwrap();
        answered += 1;
    }
    assert!(answered > 3, "the control: the disk was not slow, {answered}");
    for upload in uploads {
        upload.await.unwrap().unwrap();
    }
    let model = trained(client).await.model.unwrap();
    for answer in reads(client, &model).await {
        answer.unwrap();
    }
    disk.ends_sound().await;
}
