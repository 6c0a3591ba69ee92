//! Replicas on one database and one bucket: a capture is uploaded to one server, trained by another's worker,
//! and rendered by a third.

use relume::server::{ServeError, ServerConfig};
use relume::store::{DatabaseUrl, StoreError};
use relume::testing::{TestServer, database_of, spawn_with};
use relume_api::jobs::JobState;
use tempfile::TempDir;

use crate::s3::bucket::Bucket;
use crate::service_calibration::middle;
use crate::service_support::{capture_zip, ended};
use crate::workers::fleet::{Process, short_job, without_workers};

/// A server on a database and a bucket, with its own data directory.
async fn server(url: &DatabaseUrl, bucket: &Bucket, change: impl FnOnce(&mut ServerConfig)) -> TestServer {
    let configure = |config: &mut ServerConfig| {
        config.database = Some(url.clone());
        config.artifacts = Some(bucket.place());
        change(config);
    };
    spawn_with(TempDir::new().unwrap(), configure).await.unwrap()
}

fn replica(config: &mut ServerConfig) {
    without_workers(config);
    config.replica = true;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL: .ci/postgres"]
async fn on_postgres_replicas_train_and_render_and_refuse_uploads() {
    let (data, folder) = (TempDir::new().unwrap(), TempDir::new().unwrap());
    let url = database_of(data.path()).await.unwrap().unwrap();
    let bucket = Bucket::start().await;
    let first = server(&url, &bucket, without_workers).await;
    let capture = first.client().upload_capture_bytes(capture_zip()).await.unwrap().id;
    let second = server(&url, &bucket, replica).await;
    let third = server(&url, &bucket, replica).await;
    let id = second.client().create_job(&short_job(&capture), None).await.unwrap().id;
    let mut worker = Process::start(second.client(), folder.path(), &["--once"]);
    assert_eq!(worker.end().await.code(), Some(0));
    let done = ended(third.client(), &id).await;
    assert_eq!(done.state, JobState::Succeeded, "{:?}", done.error);
    let model = done.model.unwrap();
    let shown = third.client().thumbnail(&model, "size=64").await.unwrap();
    assert_eq!(shown, first.client().thumbnail(&model, "size=64").await.unwrap());

    for refused in [
        second.client().upload_capture_bytes(capture_zip()).await.map(drop),
        second.client().begin_upload(9).await.map(drop),
        second.client().delete_model(&model).await,
        second.client().calibrate(&model, &middle([0.3; 3])).await.map(drop),
        second.client().undo_calibration(&model).await.map(drop),
    ] {
        let error = refused.unwrap_err();
        let problem = error.problem().unwrap();
        assert_eq!((problem.status, problem.kind.as_str()), (421, "urn:relume:problem:first-server-only"));
    }
    first.client().calibrate(&model, &middle([0.9, 0.2, 0.1])).await.unwrap();
    let calibrated = third.client().thumbnail(&model, "size=64").await.unwrap();
    assert_eq!(calibrated, first.client().thumbnail(&model, "size=64").await.unwrap());
    let lit =
        async |server: &TestServer| server.client().thumbnail(&model, "size=64&env=studio").await.unwrap();
    let shown_calibrated = lit(&third).await;
    first.client().undo_calibration(&model).await.unwrap();
    assert_ne!(lit(&third).await, shown_calibrated, "what the first server changes is changed everywhere");
    first.client().delete_model(&model).await.unwrap();
    let gone = third.client().thumbnail(&model, "size=64").await.unwrap_err();
    assert_eq!(gone.problem().unwrap().status, 404, "what the first server deletes is gone everywhere");
    first.stop().await.unwrap();
    let left = third.client().job(&id).await.unwrap();
    assert_eq!(left.state, JobState::Succeeded, "replicas answer while the first server is away");
    second.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs PostgreSQL: .ci/postgres"]
async fn on_postgres_a_replica_refuses_a_database_without_its_schema() {
    let data = TempDir::new().unwrap();
    let url = database_of(data.path()).await.unwrap().unwrap();
    let bucket = Bucket::start().await;
    let refused = server(&url, &bucket, replica).await.stop().await.unwrap_err();
    assert!(matches!(refused, ServeError::Store(StoreError::OlderServer { found: 0, .. })), "{refused}");
    let first = server(&url, &bucket, without_workers).await;
    while first.client().models().await.is_err() {}
    let second = server(&url, &bucket, replica).await;
    second.client().models().await.unwrap();
}
