//! A long job gives way to jobs of other tenants and of higher priorities.

use std::sync::Arc;
use std::time::Duration;

use relume::jobs::ManualClock;
use relume::server::ApiKeys;
use relume::testing::{TestServer, spawn_with};
use relume_api::JobId;
use relume_api::jobs::NewJob;
use relume_api::work::{LeaseStatus, Release, WorkEnd};
use relume_client::Client;
use relume_client::work::LeasedJob;
use reqwest::Method;
use serde_json::Value;
use tempfile::TempDir;

use crate::service_support::small_job;
use crate::workers::fleet::{claimed, hello, upload, without_workers};

const OPERATOR: &str = "the-key-of-the-operator";

/// A server without workers, its clock, and the client of the operator.
async fn server() -> (TestServer, Arc<ManualClock>, Client) {
    let clock = Arc::new(ManualClock::default());
    let hands = clock.clone();
    let change = move |config: &mut relume::server::ServerConfig| {
        without_workers(config);
        config.lease.heartbeat_timeout = Duration::from_secs(60);
        config.api_keys = ApiKeys::new([OPERATOR]);
        config.clock = hands;
    };
    let server = spawn_with(TempDir::new().unwrap(), change).await.unwrap();
    let operator = Client::new(server.client().base().as_str(), Some(OPERATOR.to_owned())).unwrap();
    (server, clock, operator)
}

/// The jobs of a tenant.
struct Tenant {
    client: Client,
    job: NewJob,
}

impl Tenant {
    async fn new(operator: &Client, name: &str) -> Self {
        let scopes = ["submit", "read"];
        let body = serde_json::json!({ "name": name, "tenant": name, "scopes": scopes });
        let answer = operator.request(Method::POST, "/v1/keys").unwrap().json(&body).send().await.unwrap();
        let made: Value = serde_json::from_str(&answer.text().await.unwrap()).unwrap();
        let secret = made["secret"].as_str().unwrap_or_else(|| panic!("{made}")).to_owned();
        let client = Client::new(operator.base().as_str(), Some(secret)).unwrap();
        let job = small_job(&upload(&client).await, 100, 50);
        Self { client, job }
    }

    async fn submit(&self, change: impl FnOnce(&mut NewJob)) -> JobId {
        let mut job = self.job.clone();
        change(&mut job);
        self.client.create_job(&job, None).await.unwrap().id
    }
}

/// The next job of the worker.
async fn claim(operator: &Client) -> (JobId, LeasedJob) {
    let claimed = claimed(operator, &hello("worker-1")).await;
    let job = claimed.task.unwrap().job;
    (job.clone(), operator.leased_job(job, claimed.lease.unwrap()))
}

async fn should_yield(work: &LeasedJob) -> bool {
    work.heartbeat().await.unwrap().should_yield
}

async fn preempt(work: &LeasedJob) {
    let end = WorkEnd::Released { why: Release::Preempted };
    assert_eq!(work.end(&end).await.unwrap().status, LeaseStatus::Held);
}

#[tokio::test(flavor = "multi_thread")]
async fn running_jobs_give_way_to_other_tenants() {
    let (_server, clock, operator) = server().await;
    let (a, b) = (Tenant::new(&operator, "a").await, Tenant::new(&operator, "b").await);
    let of_a = [a.submit(|_| ()).await, a.submit(|_| ()).await, a.submit(|_| ()).await];
    let (job, work) = claim(&operator).await;
    clock.advance(Duration::from_secs(2));
    assert_eq!((&job, should_yield(&work).await), (&of_a[0], false), "only jobs of the same tenant wait");
    b.submit(|job| job.requires = vec!["big".to_owned()]).await;
    let of_b = b.submit(|_| ()).await;
    assert!(!should_yield(&work).await, "an idle worker may claim it first");
    clock.advance(Duration::from_secs(2));
    assert!(should_yield(&work).await);
    work.put_checkpoint(40, "state".into()).await.unwrap();
    preempt(&work).await;
    let paused = a.client.job(&of_a[0]).await.unwrap();
    let message = paused.progress.message.as_deref();
    assert_eq!(message, Some("paused: other jobs run first"));

    let (job, work) = claim(&operator).await;
    assert_eq!(job, of_b, "the job of the other tenant runs before the older jobs of the first");
    assert!(should_yield(&work).await, "the first tenant has no running job now");
    preempt(&work).await;
    let claimed = claimed(&operator, &hello("worker-1")).await;
    let task = claimed.task.unwrap();
    let resumed = (&task.job, task.checkpoint_step, task.is_last_attempt);
    assert_eq!(resumed, (&of_a[0], Some(40), false), "it continues before the younger jobs of its tenant");
}

#[tokio::test(flavor = "multi_thread")]
async fn running_jobs_give_way_to_higher_priorities_only() {
    let (_server, clock, operator) = server().await;
    let a = Tenant::new(&operator, "a").await;
    let low = a.submit(|job| job.priority = -1).await;
    let (job, work) = claim(&operator).await;
    a.submit(|job| job.priority = -2).await;
    clock.advance(Duration::from_secs(2));
    assert_eq!((&job, should_yield(&work).await), (&low, false), "a lower priority waits");
    let high = a.submit(|_| ()).await;
    clock.advance(Duration::from_secs(2));
    assert!(should_yield(&work).await, "also of the same tenant");
    preempt(&work).await;
    let (job, work) = claim(&operator).await;
    assert_eq!((&job, should_yield(&work).await), (&high, false));
    work.end(&WorkEnd::Failed { code: "broken".to_owned(), detail: "it broke".to_owned() }).await.unwrap();
    assert_eq!(claim(&operator).await.0, low);
}
