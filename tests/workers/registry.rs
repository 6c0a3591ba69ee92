//! The worker registry: labels, devices, draining, permissions.

use std::collections::BTreeSet;

use relume::testing::spawn_with;
use relume_api::jobs::{JobDevice, JobState};
use relume_api::keys::{NewKey, Scope};
use relume_api::work::{WorkerChange, WorkerState};
use relume_client::Client;
use reqwest::Method;
use tempfile::TempDir;

use crate::service_support::{ended, small_job, trained};
use crate::workers::fleet::{claimed, hello, short_job, spawn_server, upload, without_workers};

#[tokio::test(flavor = "multi_thread")]
async fn a_job_is_given_only_to_a_worker_with_its_labels() {
    let server = spawn_server().await;
    let client = server.client();
    let capture = upload(client).await;
    let mut job = short_job(&capture);
    job.requires = vec!["big".to_owned(), "berlin".to_owned()];
    let id = client.create_job(&job, None).await.unwrap().id;
    let mut worker = hello("worker-1");
    worker.labels = vec!["big".to_owned()];
    assert!(client.claim_job(&worker).await.unwrap().task.is_none(), "it lacks a label");
    worker.labels = ["berlin", "dry", "big"].map(str::to_owned).to_vec();
    let given = client.claim_job(&worker).await.unwrap().task.unwrap();
    assert_eq!((given.job, given.attempt), (id, 1));
    job.requires = vec!["no label".to_owned()];
    let refused = client.create_job(&job, None).await.unwrap_err();
    assert_eq!(refused.problem().unwrap().errors[0].pointer, "/requires");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_gpu_job_waits_for_a_worker_with_a_gpu() {
    let server = spawn_server().await;
    let client = server.client();
    let capture = upload(client).await;
    let mut job = short_job(&capture);
    job.device = JobDevice::Gpu;
    let id = client.create_job(&job, None).await.unwrap().id;
    assert!(client.claim_job(&hello("worker-1")).await.unwrap().task.is_none());
    let mut worker = hello("worker-2");
    worker.has_gpu = true;
    assert_eq!(client.claim_job(&worker).await.unwrap().task.unwrap().job, id);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_drained_worker_gets_no_more_jobs() {
    let server = spawn_server().await;
    let client = server.client();
    let capture = upload(client).await;
    let worker = hello("worker-1");
    assert!(!client.claim_job(&worker).await.unwrap().draining);
    let drained = client.change_worker(&worker.id, &WorkerChange { draining: true }).await.unwrap();
    assert_eq!(drained.state, WorkerState::Draining);
    client.create_job(&short_job(&capture), None).await.unwrap();
    let answer = client.claim_job(&worker).await.unwrap();
    assert!(answer.draining && answer.task.is_none());
    client.change_worker(&worker.id, &WorkerChange { draining: false }).await.unwrap();
    assert!(client.claim_job(&worker).await.unwrap().task.is_some(), "the control");
    let missing = client.change_worker(&"worker-9".into(), &WorkerChange { draining: true }).await;
    assert_eq!(missing.unwrap_err().problem().unwrap().status, 404);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_local_worker_is_registered_and_can_be_drained() {
    let server = relume::testing::spawn().await.unwrap();
    let client = server.client();
    let capture = upload(client).await;
    let first = client.create_job(&short_job(&capture), None).await.unwrap().id;
    let done = ended(client, &first).await;
    let workers = client.workers().await.unwrap().items;
    assert_eq!(workers.len(), 1);
    assert!(workers[0].in_server && done.worker.as_ref() == Some(&workers[0].id));
    client.change_worker(&workers[0].id, &WorkerChange { draining: true }).await.unwrap();
    let second = client.create_job(&small_job(&capture, 2, 1), None).await.unwrap().id;
    tokio::time::sleep(std::time::Duration::from_millis(2500)).await;
    assert_eq!(client.job(&second).await.unwrap().state, JobState::Queued);
    client.change_worker(&workers[0].id, &WorkerChange { draining: false }).await.unwrap();
    assert_eq!(ended(client, &second).await.state, JobState::Succeeded, "the control");
    let data = server.stop().await.unwrap();
    let server = spawn_with(data, without_workers).await.unwrap();
    assert!(server.client().workers().await.unwrap().items.is_empty(), "it went with its server");
}

#[tokio::test(flavor = "multi_thread")]
async fn work_scope_allows_only_claiming_jobs() {
    let operator = "an-operators-key-0123456789";
    let server = spawn_with(TempDir::new().unwrap(), |config| {
        without_workers(config);
        config.api_keys = relume::server::ApiKeys::new([operator]);
    })
    .await
    .unwrap();
    let base = server.client().base().as_str();
    let admin = Client::new(base, Some(operator.to_owned())).unwrap();
    let with = async |scopes: &[Scope], tenant: Option<&str>| {
        let new = NewKey {
            name: "of a test".to_owned(),
            scopes: scopes.to_vec(),
            tenant: tenant.map(Into::into),
            expires_in: None,
        };
        admin.create_key(&new).await.map(|key| Client::new(base, Some(key.secret)).unwrap())
    };
    let status = |result: Result<_, relume::ClientError>| match result {
        Ok(_) => 200,
        Err(error) => error.problem().unwrap().status,
    };
    let worker = with(&[Scope::Work], None).await.unwrap();
    assert_eq!(status(worker.claim_job(&hello("worker-1")).await.map(drop)), 200);
    assert_eq!(status(worker.jobs().await.map(drop)), 403);
    assert_eq!(status(worker.workers().await.map(drop)), 403);
    let reader = with(&[Scope::Read, Scope::Submit, Scope::Render], None).await.unwrap();
    assert_eq!(status(reader.claim_job(&hello("worker-2")).await.map(drop)), 403);
    assert!(with(&[Scope::Work], Some("studio-a")).await.is_err(), "jobs are of all tenants");
    claimed_by_nobody(&admin).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_metric_on_the_grafana_dashboard_exists() {
    let server = relume::testing::spawn().await.unwrap();
    let client = server.client();
    let job = trained(client).await;
    client.thumbnail(&job.model.unwrap(), "size=32").await.unwrap();
    let metrics =
        client.request(Method::GET, "/metrics").unwrap().send().await.unwrap().text().await.unwrap();
    let text = include_str!("../../deploy/grafana/relume.json");
    let dashboard: serde_json::Value = serde_json::from_str(text).unwrap();
    let panels = dashboard["panels"].as_array().unwrap();
    let mut names = BTreeSet::new();
    for target in panels.iter().flat_map(|panel| panel["targets"].as_array().unwrap()) {
        let expression = target["expr"].as_str().unwrap();
        let words = expression.split(|c: char| !c.is_ascii_alphanumeric() && c != '_');
        names.extend(words.filter(|word| word.starts_with("relume_")).map(str::to_owned));
    }
    assert!(names.len() >= 7, "{names:?}");
    let is_there = |name: &str| {
        metrics
            .lines()
            .any(|line| line.starts_with(&format!("{name}{{")) || line.starts_with(&format!("{name} ")))
    };
    let missing: Vec<_> = names.iter().filter(|name| !is_there(name)).collect();
    assert!(missing.is_empty(), "{missing:?} in\n{metrics}");
    assert!(!is_there("relume_no_such_metric"), "the control");
}

/// Invalid messages are refused with the name of the field.
async fn claimed_by_nobody(admin: &Client) {
    let mut wrong = hello("worker-1");
    wrong.id = "short".into();
    let refused = admin.claim_job(&wrong).await.unwrap_err();
    assert_eq!(refused.problem().unwrap().errors[0].pointer, "/id");
    let mut other = hello("worker-1");
    other.version = "0.0.1".to_owned();
    let refused = admin.claim_job(&other).await.unwrap_err();
    assert_eq!(refused.problem().unwrap().errors[0].pointer, "/version");
    let capture = upload(admin).await;
    admin.create_job(&short_job(&capture), None).await.unwrap();
    let mine = claimed(admin, &hello("worker-1")).await;
    let task = mine.task.unwrap();
    let work = admin.leased_job(task.job.clone(), mine.lease.unwrap());
    for name in ["..", ".hidden", "checkpoint-00000010-x.safetensors"] {
        let refused = work.put_file(name, "bytes".into()).await.unwrap_err();
        assert!(refused.problem().is_none_or(|p| matches!(p.status, 404 | 405 | 422)), "{name}: {refused}");
    }
    let foreign = admin.leased_job(task.job, "a-lease-that-nobody-has".to_owned());
    assert_eq!(foreign.heartbeat().await.unwrap_err().problem().unwrap().status, 409);
}
