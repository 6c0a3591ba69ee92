//! Signed URLs: valid without a key, only for the signed resource, until they expire.

use std::process::Command;
use std::sync::Arc;
use std::time::Duration;

use relume::jobs::ManualClock;
use relume::server::{ApiKeys, ServerConfig};
use relume::testing::{self, TestServer};
use relume_api::exports::{NewExport, SplatsExport, SplatsKind};
use relume_api::jobs::JobView;
use relume_capture::formats::image_file;
use relume_client::Client;
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::service_support::{capture_zip, small_job, trained};

const OPERATOR: &str = "the-operators-own-key";

async fn start(data: TempDir, keys: &[&str], clock: &Arc<ManualClock>) -> TestServer {
    let (keys, clock) = (ApiKeys::new(keys), clock.clone());
    let change = |config: &mut ServerConfig| (config.api_keys, config.clock) = (keys, clock);
    testing::spawn_with(data, change).await.unwrap()
}

fn bearer(server: &TestServer, key: &str) -> Client {
    Client::new(server.client().base().as_str(), Some(key.to_owned())).unwrap()
}

async fn post(client: &Client, path: &str, body: Value) -> (u16, Value) {
    let answer = client.request(Method::POST, path).unwrap().json(&body).send().await.unwrap();
    (answer.status().as_u16(), serde_json::from_str(&answer.text().await.unwrap()).unwrap_or_default())
}

/// A signed URL, valid for an hour.
async fn signed(client: &Client, path: &str) -> String {
    let (status, signed) = post(client, "/v1/signed-urls", json!({ "path": path })).await;
    assert_eq!(status, 200, "{signed}");
    signed["url"].as_str().unwrap().to_owned()
}

/// The answer for a browser without a key.
async fn load(server: &TestServer, method: Method, url: &str) -> (u16, Vec<u8>) {
    let answer = server.client().request(method, url).unwrap().send().await.unwrap();
    (answer.status().as_u16(), answer.bytes().await.unwrap().to_vec())
}

async fn status(server: &TestServer, url: &str) -> u16 {
    load(server, Method::GET, url).await.0
}

/// A server with the operator's key, and a job with a model.
async fn with_model() -> (TestServer, Arc<ManualClock>, Client, JobView) {
    let clock = Arc::new(ManualClock::default());
    let server = start(TempDir::new().unwrap(), &[OPERATOR], &clock).await;
    let client = bearer(&server, OPERATOR);
    let job = trained(&client).await;
    (server, clock, client, job)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_signed_url_works_without_a_key_until_it_expires() {
    let (server, clock, client, job) = with_model().await;
    let model = job.model.unwrap();
    let thumbnail = signed(&client, &format!("/v1/models/{model}/thumbnail?size=32&env=studio")).await;
    let file = signed(&client, &format!("/v1/models/{model}/files/model.ply")).await;
    let events = signed(&client, &format!("/v1/jobs/{}/events?after=0", job.id)).await;
    assert_eq!(image_file::dimensions(&load(&server, Method::GET, &thumbnail).await.1).unwrap(), (32, 32));
    let whole = client.file(&model, "model.ply").await.unwrap();
    assert_eq!(load(&server, Method::GET, &file).await.1, whole);
    let ply = NewExport::Splats(SplatsExport::of(SplatsKind::Ply));
    let export = client.create_export(&model, &ply, None).await.unwrap().id;
    client.wait_for_export(&export, |_| {}).await.unwrap();
    let made = signed(&client, &format!("/v1/exports/{export}/file")).await;
    assert_eq!(load(&server, Method::GET, &made).await.1, client.export_file(&export).await.unwrap());
    let told = String::from_utf8(load(&server, Method::GET, &events).await.1).unwrap();
    assert!(told.contains("succeeded"), "{told}");
    for url in [&thumbnail, &file, &made, &events] {
        assert_eq!(load(&server, Method::HEAD, url).await.0, 200, "{url}");
        assert_eq!(status(&server, url.split('?').next().unwrap()).await, 401, "without the signature");
    }
    clock.advance(Duration::from_secs(3599));
    assert_eq!(status(&server, &thumbnail).await, 200);
    clock.advance(Duration::from_secs(1));
    for url in [&thumbnail, &file, &events] {
        assert_eq!(status(&server, url).await, 403, "{url} has expired");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_event_stream_ends_when_its_signed_url_expires() {
    let clock = Arc::new(ManualClock::default());
    let server = start(TempDir::new().unwrap(), &[OPERATOR], &clock).await;
    let client = bearer(&server, OPERATOR);
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    let job = client.create_job(&small_job(&capture.id, 1_000_000, 1_000_000), None).await.unwrap();
    let path = format!("/v1/jobs/{}/events", job.id);
    let (status, signed) = post(&client, "/v1/signed-urls", json!({ "path": path, "expires_in": 2 })).await;
    assert_eq!(status, 200, "{signed}");
    let url = signed["url"].as_str().unwrap();
    let mut stream = server.client().request(Method::GET, url).unwrap().send().await.unwrap();
    assert!(stream.chunk().await.unwrap().is_some(), "the control: it is heard");
    clock.advance(Duration::from_secs(2));
    let ends = async { while stream.chunk().await.unwrap().is_some() {} };
    tokio::time::timeout(Duration::from_secs(60), ends).await.expect("the stream goes on");
    let running = client.job(&job.id).await.unwrap().state;
    assert!(!running.is_terminal(), "the job goes on: {running:?}");
    client.cancel_job(&job.id).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn rotating_the_secret_ends_streams_of_signed_urls_only() {
    let clock = Arc::new(ManualClock::default());
    let server = start(TempDir::new().unwrap(), &[OPERATOR], &clock).await;
    let client = bearer(&server, OPERATOR);
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    let job = client.create_job(&small_job(&capture.id, 1_000_000, 1_000_000), None).await.unwrap();
    let path = format!("/v1/jobs/{}/events", job.id);
    let url = signed(&client, &path).await;
    let mut by_url = server.client().request(Method::GET, &url).unwrap().send().await.unwrap();
    let mut by_key = client.request(Method::GET, &path).unwrap().send().await.unwrap();
    assert!(by_url.chunk().await.unwrap().is_some() && by_key.chunk().await.unwrap().is_some());
    end_signed_urls(&server);
    let ends = async { while by_url.chunk().await.unwrap().is_some() {} };
    tokio::time::timeout(Duration::from_secs(60), ends).await.expect("the stream goes on");
    client.cancel_job(&job.id).await.unwrap();
    let mut told = String::new();
    while let Some(chunk) = by_key.chunk().await.unwrap() {
        told += std::str::from_utf8(&chunk).unwrap();
    }
    assert!(told.contains("cancelled"), "the other hears the end: {told}");
}

/// Invalidates all signed URLs, as an operator does.
fn end_signed_urls(server: &TestServer) {
    let mut end = Command::new(env!("CARGO_BIN_EXE_relume"));
    let ended = end.args(["keys", "end-signed-urls", "--data-dir"]).arg(server.data_dir()).status().unwrap();
    assert!(ended.success());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_changed_signed_url_answers_403() {
    let (server, _, client, job) = with_model().await;
    let model = job.model.unwrap();
    let url = signed(&client, &format!("/v1/models/{model}/thumbnail?size=32&env=studio")).await;
    assert_eq!(status(&server, &url).await, 200);
    let more = |url: &str| url.replace("expires=", "expires=9");
    let last = if url.ends_with('0') { "1" } else { "0" };
    let changed = [
        url.replace("size=32", "size=33"),
        url.replace("env=studio", "env=sunset"),
        url.replace("size=32&env=studio", "env=studio&size=32"),
        url.replace("thumbnail", "files/model.ply"),
        url.replace("thumbnail", "card"),
        url.replace("key=configured-1", "key=configured-2"),
        url.replace("key=configured-1", "key=none"),
        more(&url),
        format!("{url}&azimuth=3"),
        url.replace("&key=", "&azimuth=3&key="),
        format!("{}{last}", &url[..url.len() - 1]),
        url.split("&key=").next().unwrap().to_owned() + "&signature=",
    ];
    for changed in changed {
        assert_ne!(changed, url);
        let (status, body) = load(&server, Method::GET, &changed).await;
        let body: Value = serde_json::from_slice(&body).unwrap();
        assert_eq!((status, &body["type"]), (403, &json!("urn:relume:problem:bad-signature")), "{changed}");
    }
    assert_eq!(load(&server, Method::POST, &url).await.0, 403, "it reads");
    let query = url.split('?').nth(1).unwrap();
    for other in ["/v1/jobs", "/v1/keys", "/metrics"] {
        assert_eq!(status(&server, &format!("{other}?{query}")).await, 403, "{other}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_paths_and_lifetimes_cannot_be_signed() {
    let (server, _, client, job) = with_model().await;
    let model = job.model.unwrap();
    let good = format!("/v1/models/{model}/thumbnail");
    for (body, pointer) in [
        (json!({ "path": format!("/v1/models/{model}") }), "/path"),
        (json!({ "path": format!("/v1/jobs/{}", job.id) }), "/path"),
        (json!({ "path": "/v1/keys" }), "/path"),
        (json!({ "path": format!("https://elsewhere.example{good}") }), "/path"),
        (json!({ "path": format!("{good}?a b") }), "/path"),
        (json!({ "path": "" }), "/path"),
        (json!({ "path": format!("{good}?size=16&expires=1") }), "/path"),
        (json!({ "path": format!("{good}?{}", "a".repeat(2048)) }), "/path"),
        (json!({ "path": good, "expires_in": 0 }), "/expires_in"),
        (json!({ "path": good, "expires_in": 604_801 }), "/expires_in"),
        (json!({}), "/path"),
    ] {
        let (status, refused) = post(&client, "/v1/signed-urls", body).await;
        assert_eq!((status, &refused["errors"][0]["pointer"]), (422, &json!(pointer)), "{refused}");
    }
    // A key without the scope `read` cannot sign.
    let key = json!({ "name": "x", "scopes": ["render", "submit", "admin"] });
    let blind = post(&client, "/v1/keys", key).await.1["secret"].as_str().unwrap().to_owned();
    assert_eq!(post(&bearer(&server, &blind), "/v1/signed-urls", json!({ "path": good })).await.0, 403);
}

#[tokio::test(flavor = "multi_thread")]
async fn signed_urls_end_with_their_key_and_with_the_secret() {
    let (server, clock, client, job) = with_model().await;
    let path = format!("/v1/models/{}/files/model.ply", job.model.unwrap());
    let made = async |body: Value| {
        let made = post(&client, "/v1/keys", body).await.1;
        (made["id"].as_str().unwrap().to_owned(), bearer(&server, made["secret"].as_str().unwrap()))
    };
    let (id, reader) = made(json!({ "name": "reader", "scopes": ["read"] })).await;
    let url = signed(&reader, &path).await;
    assert_eq!(status(&server, &url).await, 200);
    post(&client, &format!("/v1/keys/{id}/revoke"), json!({})).await;
    assert_eq!(status(&server, &url).await, 403, "its key is revoked");

    let (_, short) = made(json!({ "name": "short", "scopes": ["read"], "expires_in": 60 })).await;
    let (_, answer) = post(&short, "/v1/signed-urls", json!({ "path": path })).await;
    assert_eq!(answer["expires_at"], "1970-01-01T00:01:00Z", "not beyond its key");
    let url = answer["url"].as_str().unwrap();
    clock.advance(Duration::from_secs(59));
    assert_eq!(status(&server, url).await, 200);
    clock.advance(Duration::from_secs(1));
    assert_eq!(status(&server, url).await, 403);

    let url = signed(&client, &path).await;
    assert_eq!(status(&server, &url).await, 200);
    end_signed_urls(&server);
    assert_eq!(status(&server, &url).await, 403, "the secret is another");
    assert_eq!(status(&server, &signed(&client, &path).await).await, 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_event_stream_ends_when_its_key_is_revoked() {
    let clock = Arc::new(ManualClock::default());
    let server = start(TempDir::new().unwrap(), &[OPERATOR], &clock).await;
    let client = bearer(&server, OPERATOR);
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap().id;
    let job = client.create_job(&small_job(&capture, 100_000, 50_000), None).await.unwrap();
    let key = json!({ "name": "reader", "scopes": ["read"] });
    let made = post(&client, "/v1/keys", key).await.1;
    let reader = bearer(&server, made["secret"].as_str().unwrap());
    let url = signed(&reader, &format!("/v1/jobs/{}/events", job.id)).await;
    let listening = server.client().request(Method::GET, &url).unwrap().send().await.unwrap();
    assert_eq!(listening.status(), StatusCode::OK);
    post(&client, &format!("/v1/keys/{}/revoke", made["id"].as_str().unwrap()), json!({})).await;
    let told = tokio::time::timeout(Duration::from_secs(60), listening.text()).await;
    assert!(told.expect("the stream ends").unwrap().contains("queued"));
    assert!(!client.job(&job.id).await.unwrap().state.is_terminal(), "the job goes on");
    client.cancel_job(&job.id).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn removing_a_configured_key_invalidates_its_signed_urls() {
    let (server, clock, client, job) = with_model().await;
    let url = signed(&client, &format!("/v1/models/{}/files/model.ply", job.model.unwrap())).await;
    let data = server.stop().await.unwrap();
    // Another key now has its number.
    let server = start(data, &["another-key-of-the-operator"], &clock).await;
    assert_eq!(status(&server, &url).await, 403);
    let server = start(server.stop().await.unwrap(), &[OPERATOR], &clock).await;
    assert_eq!(status(&server, &url).await, 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn creating_the_first_key_invalidates_urls_signed_without_one() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let job = trained(client).await;
    let url = signed(client, &format!("/v1/jobs/{}/events", job.id)).await;
    assert_eq!(status(&server, &url).await, 200);
    let mut create = Command::new(env!("CARGO_BIN_EXE_relume"));
    create.args(["keys", "create", "--name", "first", "--data-dir"]).arg(server.data_dir());
    assert!(create.output().unwrap().status.success());
    assert_eq!(status(&server, &url).await, 403);
}
