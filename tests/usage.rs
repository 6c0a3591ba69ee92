//! Storage use, and the enforcement of storage limits.

use relume::server::ServerConfig;
use relume::testing::{self, TestServer};
use relume_api::TenantId;
use relume_api::usage::StoredKind;
use relume_client::ClientError;
use tempfile::TempDir;

use crate::crash::noise;
use crate::service_support::{CaptureZip, capture_zip, files_under, open_store, small_job, trained, until};

/// Bytes of the artifacts whose names have a part.
fn on_disk(server: &TestServer, part: &str) -> u64 {
    let files = files_under(&server.data_dir().join("artifacts"));
    files.iter().filter(|(name, _)| name.contains(part)).map(|(_, size)| size).sum()
}

#[tokio::test(flavor = "multi_thread")]
async fn usage_counts_stored_bytes_by_kind() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let empty = client.usage().await.unwrap();
    assert_eq!((empty.captures.count, empty.models.count, empty.unreferenced_bytes), (0, 0, 0));
    assert!(empty.free_bytes > Some(0) && empty.limit_bytes.is_none());
    let job = trained(client).await;
    client.upload_capture_bytes(CaptureZip::new(9, 16).zip()).await.unwrap();
    // An orphan.
    std::fs::create_dir_all(server.data_dir().join("artifacts/orphans")).unwrap();
    std::fs::write(server.data_dir().join("artifacts/orphans/old"), [0; 777]).unwrap();
    let usage = client.usage().await.unwrap();
    assert_eq!(usage.captures, StoredKind { count: 2, bytes: on_disk(&server, "captures/") });
    assert_eq!(usage.models, StoredKind { count: 1, bytes: on_disk(&server, "/model.") });
    assert_eq!((usage.environments, usage.checkpoints), (StoredKind::default(), StoredKind::default()));
    assert_eq!(usage.unreferenced_bytes, 777);

    let long = client.create_job(&small_job(&job.capture, 1_000_000, 10), None).await.unwrap();
    until(client, &long.id, |job| job.progress.step > 20).await;
    let data = server.stop().await.unwrap();
    // No worker runs the job while its checkpoint is counted.
    let store = open_store(data.path()).await;
    let checkpoints = store.usage(&TenantId::of_operator(), true).await.unwrap().checkpoints;
    let files = files_under(data.path());
    let sizes: Vec<u64> = files.iter().filter(|f| f.0.contains("/checkpoint-")).map(|f| f.1).collect();
    assert_eq!((sizes.len(), checkpoints), (1, StoredKind { count: 1, bytes: sizes[0] }));
    store.close().await;
}

/// The detail of a 507 answer.
fn beyond<T: std::fmt::Debug>(answer: Result<T, ClientError>) -> String {
    let error = answer.expect_err("the limit is reached");
    let problem = error.problem().unwrap_or_else(|| panic!("{error}"));
    assert_eq!((problem.status, problem.kind.as_str()), (507, "urn:relume:problem:storage-limit"));
    problem.detail.clone().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn over_the_disk_limit_uploads_and_jobs_answer_507() {
    let small = capture_zip();
    let limit = small.len() as u64 + 100_000;
    let limited = |bytes: u64| move |config: &mut ServerConfig| config.limits.disk_bytes = Some(bytes);
    let server = testing::spawn_with(TempDir::new().unwrap(), limited(limit)).await.unwrap();
    let client = server.client();
    let mut large = CaptureZip::new(8, 32);
    large.images.push(("noise.bin".to_owned(), noise(200_000)));
    let large = large.zip();
    // The length is declared, or it is not; then the limit is detected during the transfer.
    let said = beyond(client.upload_capture_bytes(large.clone()).await);
    assert!(said.contains(&format!("the storage limit is {limit} bytes: 0 are stored")), "{said}");
    let pieces = futures::stream::iter(
        large.chunks(10_000).map(|c| Ok::<_, std::io::Error>(c.to_vec())).collect::<Vec<_>>(),
    );
    let streamed = client.request(reqwest::Method::POST, "/v1/captures").unwrap();
    let streamed =
        streamed.header("content-type", "application/zip").body(reqwest::Body::wrap_stream(pieces));
    let answer = streamed.send().await.unwrap();
    assert_eq!(answer.status(), 507);
    assert!(files_under(server.data_dir()).is_empty(), "nothing is left of them");

    let capture = client.upload_capture_bytes(small.clone()).await.unwrap();
    assert_eq!(client.usage().await.unwrap().limit_bytes, Some(limit));
    let server =
        testing::spawn_with(server.stop().await.unwrap(), limited(small.len() as u64)).await.unwrap();
    let client = server.client();
    let said = beyond(client.create_job(&small_job(&capture.id, 5, 5), None).await);
    assert!(said.contains(&format!("{} are stored and 1 more", small.len())), "{said}");
    // After a deletion uploads are accepted again.
    client.delete_capture(&capture.id, false).await.unwrap();
    // The file is removed before its row, which counts it.
    let mut again = client.upload_capture_bytes(small.clone()).await;
    for _ in 0..500 {
        if again.is_ok() {
            break;
        }
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
        again = client.upload_capture_bytes(small.clone()).await;
    }
    again.unwrap();
}
