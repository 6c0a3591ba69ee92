//! Traces: the trace that a job stores of its request, and the spans that reach a collector.

#[cfg(feature = "otlp")]
mod collector;
#[cfg(feature = "otlp")]
mod sent;

use relume::testing::spawn_with;
use relume_api::TenantId;
use relume_api::jobs::NewJob;
use relume_client::Client;
use reqwest::Method;
use serde_json::Value;
use tempfile::TempDir;

use crate::service_support::{capture_zip, open_store, small_job};
use crate::workers::fleet::{claimed, hello, without_workers};

/// The trace and the span that a caller sends.
const JOB_TRACE: &str = "4bf92f3577b34da6a3ce929d0e0e4736";
const CALLER: &str = "00f067aa0ba902b7";

/// The header `traceparent` of a caller.
fn traceparent(trace: &str) -> String {
    format!("00-{trace}-{CALLER}-01")
}

/// Posts a job with these headers; returns its view.
async fn post(client: &Client, job: &NewJob, traceparents: &[&str]) -> Value {
    let mut request = client.request(Method::POST, "/v1/jobs").unwrap().json(job);
    for traceparent in traceparents {
        request = request.header("traceparent", *traceparent);
    }
    let response = request.send().await.unwrap();
    assert_eq!(response.status(), 202, "a trace is no reason to refuse a job");
    response.json().await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_stores_a_valid_traceparent_and_ignores_invalid_ones() {
    let server = spawn_with(TempDir::new().unwrap(), without_workers).await.unwrap();
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap().id;
    let job = small_job(&capture, 10, 5);
    let valid = traceparent(JOB_TRACE);
    let cases: [(&[&str], Option<&str>); 5] = [
        (&[&valid], Some(&valid)),
        (&[], None),
        (&["00-nonsense"], None),
        (&["00-00000000000000000000000000000000-00f067aa0ba902b7-01"], None),
        (&[&valid, &valid], None),
    ];
    let mut expected = Vec::new();
    for (sent, stored) in cases {
        let view = post(client, &job, sent).await;
        assert!(!view.to_string().contains(JOB_TRACE), "clients are not told: {view}");
        expected.push((view["id"].as_str().unwrap().to_owned(), stored));
    }
    let given = claimed(client, &hello("worker-of-traces")).await.task.unwrap();
    assert_eq!(given.traceparent.as_deref(), Some(&*valid), "a worker gets it with the first job");
    let data = server.stop().await.unwrap();
    let store = open_store(data.path()).await;
    for (id, stored) in expected {
        let found = store.job(&TenantId::of_operator(), &id.into()).await.unwrap().unwrap();
        assert_eq!(found.traceparent.as_deref(), stored);
    }
}
