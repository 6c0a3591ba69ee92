//! The requests of a worker that has lost its lease have no effect.

use std::time::Duration;

use relume::testing::spawn_with;
use relume_api::jobs::{JobProgress, JobState};
use relume_api::quality::Figures;
use relume_api::work::{FinishedModel, LeaseStatus, Release, WorkEnd};
use relume_client::ClientError;
use relume_client::work::LeasedJob;

use crate::service_support::until;
use crate::workers::fleet::{claimed, hello, short_job, spawn_server, upload, without_workers};

/// Sends a model of two files and publishes it.
async fn publish(work: &LeasedJob, bytes: &'static str) -> Result<LeaseStatus, ClientError> {
    let files = vec![
        work.put_file("model.safetensors", bytes.into()).await?,
        work.put_file("model.ply", bytes.into()).await?,
    ];
    let card = serde_json::json!({ "of": bytes });
    let model = FinishedModel { gaussians: 1, card, figures: Figures::default(), files };
    Ok(work.publish(&model).await?.status)
}

#[tokio::test(flavor = "multi_thread")]
async fn only_the_current_lease_can_publish() {
    let server = spawn_server().await;
    let client = server.client();
    let capture = upload(client).await;
    let id = client.create_job(&short_job(&capture), None).await.unwrap().id;
    let first = claimed(client, &hello("worker-1")).await;
    let stale = client.leased_job(id.clone(), first.lease.unwrap());
    assert_eq!(stale.heartbeat().await.unwrap().status, LeaseStatus::Held);
    let sent = stale.put_file("model.safetensors", "stale".into()).await.unwrap();
    // The first worker sends no heartbeat for too long.
    let second = claimed(client, &hello("worker-2")).await;
    assert_eq!(second.task.unwrap().attempt, 2);
    let standing = client.leased_job(id.clone(), second.lease.unwrap());

    let figures = Figures::default();
    let model = FinishedModel { gaussians: 1, card: serde_json::json!({}), figures, files: vec![sent] };
    let refused = [
        stale.heartbeat().await.map(drop),
        stale.progress(&JobProgress::default()).await.map(drop),
        stale.warn("too late").await.map(drop),
        stale.put_checkpoint(30, "stale".into()).await.map(drop),
        stale.put_file("model.ply", "stale".into()).await.map(drop),
        stale.publish(&model).await.map(drop),
        stale.end(&WorkEnd::Failed { code: "x".to_owned(), detail: "y".to_owned() }).await.map(drop),
        stale.end(&WorkEnd::Released { why: Release::Shutdown }).await.map(drop),
        stale.capture().await.map(drop),
    ];
    for refusal in refused {
        let error = refusal.unwrap_err();
        let problem = error.problem().unwrap();
        assert!(problem.status == 409 && problem.kind.ends_with("lease-lost"), "{problem:?}");
    }
    assert_eq!(client.job(&id).await.unwrap().state, JobState::Running);
    assert_eq!(publish(&standing, "good").await.unwrap(), LeaseStatus::Held, "the control");
    let done = client.job(&id).await.unwrap();
    assert_eq!(done.state, JobState::Succeeded);
    let bytes = client.file(&done.model.unwrap(), "model.safetensors").await.unwrap();
    assert_eq!(bytes.as_ref(), b"good");
    assert!(publish(&standing, "again").await.is_err(), "a job publishes once");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_model_with_mismatching_files_is_not_published() {
    let server = spawn_server().await;
    let client = server.client();
    let capture = upload(client).await;
    let id = client.create_job(&short_job(&capture), None).await.unwrap().id;
    let claim = claimed(client, &hello("worker-1")).await;
    let work = client.leased_job(id.clone(), claim.lease.unwrap());
    let mut file = work.put_file("model.safetensors", "bytes".into()).await.unwrap();
    file.sha256 = "0".repeat(64);
    let model = |files| FinishedModel {
        gaussians: 1,
        card: serde_json::json!({}),
        figures: Figures::default(),
        files,
    };
    let refused = work.publish(&model(vec![file.clone()])).await.unwrap_err();
    assert_eq!(refused.problem().unwrap().errors[0].pointer, "/files/0");
    file.name = "../model.ply".to_owned();
    let refused = work.publish(&model(vec![file.clone()])).await.unwrap_err();
    assert_eq!(refused.problem().unwrap().errors[0].pointer, "/files/0/name");
    file.name = "model.ply".to_owned();
    assert_eq!(work.publish(&model(vec![file])).await.unwrap_err().problem().unwrap().status, 422);
    assert_eq!(client.job(&id).await.unwrap().state, JobState::Running);
    assert_eq!(publish(&work, "bytes").await.unwrap(), LeaseStatus::Held, "the control");
}

#[tokio::test(flavor = "multi_thread")]
async fn files_sent_before_a_restart_can_be_published_after_it() {
    let server = spawn_server().await;
    let capture = upload(server.client()).await;
    let id = server.client().create_job(&short_job(&capture), None).await.unwrap().id;
    let lease = claimed(server.client(), &hello("worker-1")).await.lease.unwrap();
    let work = server.client().leased_job(id.clone(), lease.clone());
    let sent = work.put_file("model.safetensors", "bytes".into()).await.unwrap();
    let data = server.stop().await.unwrap();
    // Negative control: a file of an attempt that has ended.
    let left = data.path().join(format!("artifacts/attempts/{id}/7/model.ply"));
    std::fs::create_dir_all(left.parent().unwrap()).unwrap();
    std::fs::write(&left, "left").unwrap();

    let server = spawn_with(data, without_workers).await.unwrap();
    let work = server.client().leased_job(id.clone(), lease);
    let (card, figures) = (serde_json::json!({}), Figures::default());
    let model = FinishedModel { gaussians: 1, card, figures, files: vec![sent] };
    assert_eq!(work.publish(&model).await.unwrap().status, LeaseStatus::Held);
    let done = server.client().job(&id).await.unwrap();
    let bytes = server.client().file(&done.model.unwrap(), "model.safetensors").await.unwrap();
    assert_eq!(bytes.as_ref(), b"bytes");
    assert!(!left.exists());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_keeps_its_job_only_while_it_sends_heartbeats() {
    let server = spawn_server().await;
    let client = server.client();
    let capture = upload(client).await;
    let id = client.create_job(&short_job(&capture), None).await.unwrap().id;
    let claim = claimed(client, &hello("worker-1")).await;
    assert!(claim.beat_ms > 0 && claim.beat_ms < 2000);
    let work = client.leased_job(id.clone(), claim.lease.unwrap());
    for _ in 0..20 {
        tokio::time::sleep(Duration::from_millis(claim.beat_ms)).await;
        assert_eq!(work.heartbeat().await.unwrap().status, LeaseStatus::Held);
    }
    let job = until(client, &id, |job| job.state == JobState::Queued).await;
    assert_eq!(job.attempts, 1);
}
