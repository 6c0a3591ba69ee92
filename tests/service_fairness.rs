//! Limits of keys and tenants, and the caller in the log.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use futures::channel::mpsc::UnboundedSender;
use relume::jobs::ManualClock;
use relume::server::{ApiKeys, ServerConfig};
use relume::store::{NewKeyRecord, Quota, Store};
use relume::testing::{self, TestServer};
use relume_api::TenantId;
use relume_api::keys::Scope;
use relume_client::Client;
use reqwest::{Method, Response, header};
use serde_json::Value;
use tempfile::TempDir;
use tokio::task::JoinHandle;

use crate::service_support::{ALL_OF_A_TENANT, CaptureZip, capture_zip, ended, files_under, small_job};

const KEYS: [&str; 2] = ["the-first-key-of-two", "the-second-key-of-two"];

async fn server(change: impl FnOnce(&mut ServerConfig)) -> TestServer {
    let change = |config: &mut ServerConfig| {
        config.api_keys = ApiKeys::new(KEYS);
        change(config);
    };
    testing::spawn_with(TempDir::new().unwrap(), change).await.unwrap()
}

fn bearer(server: &TestServer, key: &str) -> Client {
    Client::new(server.client().base().as_str(), Some(key.to_owned())).unwrap()
}

/// A client with a new key of a tenant.
async fn of_tenant(server: &TestServer, tenant: &str) -> Client {
    let body = serde_json::json!({ "name": "x", "tenant": tenant, "scopes": ALL_OF_A_TENANT });
    let request = bearer(server, KEYS[0]).request(Method::POST, "/v1/keys").unwrap().json(&body);
    let made: Value = serde_json::from_str(&request.send().await.unwrap().text().await.unwrap()).unwrap();
    bearer(server, made["secret"].as_str().unwrap())
}

async fn get(client: &Client, path: &str) -> Response {
    client.request(Method::GET, path).unwrap().send().await.unwrap()
}

fn told(answer: &Response, name: &str) -> String {
    answer.headers().get(name).map(|v| v.to_str().unwrap().to_owned()).unwrap_or_default()
}

/// Status and problem type of a refusal.
fn refusal<T: std::fmt::Debug>(result: Result<T, relume_client::ClientError>) -> (u16, String) {
    match result.unwrap_err() {
        relume_client::ClientError::Problem(problem) => {
            (problem.status, problem.kind.replace("urn:relume:problem:", ""))
        }
        other => panic!("{other}"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_key_over_its_rate_limit_gets_429_with_retry_after() {
    let clock = Arc::new(ManualClock::default());
    let hands = clock.clone();
    let server = server(move |config| {
        config.requests_per_minute = Some(3);
        config.clock = hands;
    })
    .await;
    let (one, other) = (bearer(&server, KEYS[0]), bearer(&server, KEYS[1]));
    for left in [2, 1, 0] {
        // Requests for missing resources and refused requests count as well.
        let answer = get(&one, ["/v1/jobs", "/v1/models/nobody", "/nowhere"][left]).await;
        assert_ne!(answer.status(), 429);
        assert_eq!(told(&answer, "ratelimit-policy"), "\"requests\";q=3;w=60, \"tenant\";q=30;w=60");
        let (full, left_to_all) = ((3 - left) * 20, 27 + left);
        let expected = format!("\"requests\";r={left};t={full}, \"tenant\";r={left_to_all};t={}", full / 10);
        assert_eq!(told(&answer, "ratelimit"), expected);
    }
    let refused = get(&one, "/v1/jobs").await;
    assert_eq!((refused.status().as_u16(), told(&refused, "retry-after")), (429, "20".to_owned()));
    assert!(told(&refused, "ratelimit").starts_with("\"requests\";r=0;t=60,"));
    let body: Value = serde_json::from_str(&refused.text().await.unwrap()).unwrap();
    assert_eq!(body["type"], "urn:relume:problem:rate-limited");
    assert_eq!(get(&other, "/v1/jobs").await.status(), 200);
    for open in ["/healthz", "/readyz"] {
        let answer = get(&one, open).await;
        assert_eq!((answer.status().as_u16(), told(&answer, "ratelimit")), (200, String::new()), "{open}");
    }
    clock.advance(Duration::from_secs(20));
    assert_eq!(get(&one, "/v1/jobs").await.status(), 200);
    assert_eq!(get(&one, "/v1/jobs").await.status(), 429);
}

#[tokio::test(flavor = "multi_thread")]
async fn more_keys_do_not_raise_the_rate_limit_of_a_tenant() {
    let clock = Arc::new(ManualClock::default());
    let hands = clock.clone();
    let server = server(move |config| {
        config.requests_per_minute = Some(10);
        config.requests_per_minute_of_tenant = Some(12);
        config.clock = hands;
    })
    .await;
    let mut answers = Vec::new();
    for _ in 0..3 {
        let client = of_tenant(&server, "a").await;
        for _ in 0..6 {
            answers.push(get(&client, "/v1/jobs").await.status().as_u16());
        }
    }
    assert_eq!(answers, [[200; 6], [200; 6], [429; 6]].concat());
    assert_eq!(get(&of_tenant(&server, "b").await, "/v1/jobs").await.status(), 200);
    clock.advance(Duration::from_secs(5));
    assert_eq!(get(&of_tenant(&server, "a").await, "/v1/jobs").await.status(), 200, "it fills again");
}

#[tokio::test(flavor = "multi_thread")]
async fn job_quota_is_enforced_per_tenant() {
    let server = server(|config| config.quota = Quota { jobs: Some(2), bytes: None }).await;
    let (a, b) = (of_tenant(&server, "a").await, of_tenant(&server, "b").await);
    let capture = a.upload_capture_bytes(capture_zip()).await.unwrap().id;
    let long = a.create_job(&small_job(&capture, 100_000, 50_000), Some("one")).await.unwrap();
    let waits = a.create_job(&small_job(&capture, 3, 5), None).await.unwrap();
    let more = small_job(&capture, 3, 5);
    assert_eq!(refusal(a.create_job(&more, None).await), (429, "quota-exceeded".to_owned()));
    let again = a.create_job(&small_job(&capture, 100_000, 50_000), Some("one")).await.unwrap();
    assert_eq!(again.id, long.id, "a repetition asks for nothing more");
    let capture = b.upload_capture_bytes(capture_zip()).await.unwrap().id;
    let others = b.create_job(&small_job(&capture, 3, 5), None).await.unwrap();
    for id in [&long.id, &waits.id] {
        a.cancel_job(id).await.unwrap();
        ended(&a, id).await;
    }
    a.create_job(&more, None).await.unwrap();
    ended(&b, &others.id).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn storage_quota_of_a_tenant_is_enforced() {
    let bytes = capture_zip().len() as u64;
    let quota = Quota { jobs: None, bytes: Some(bytes + 100) };
    let server = server(|config| config.quota = quota).await;
    let (a, b) = (of_tenant(&server, "a").await, of_tenant(&server, "b").await);
    let first = a.upload_capture_bytes(capture_zip()).await.unwrap();
    let other = CaptureZip::new(9, 32).zip();
    let before = files_under(server.data_dir());
    assert_eq!(refusal(a.upload_capture_bytes(other).await), (507, "quota-exceeded".to_owned()));
    assert_eq!(files_under(server.data_dir()), before, "nothing is left of it");
    let map = relume_capture::formats::exr_image::encode_rgb(4, 2, &[[1.0f32; 3]; 8]).unwrap();
    assert!(map.len() > 100);
    assert_eq!(refusal(a.upload_environment(map).await).0, 507);
    assert_eq!(
        refusal(a.validate_capture_bytes(capture_zip()).await).0,
        507,
        "what is only tried takes room, too"
    );
    a.delete_capture(&first.id, false).await.unwrap();
    let first = a.upload_capture_bytes(capture_zip()).await.unwrap();
    assert_eq!(a.capture(&first.id).await.unwrap().bytes, bytes as i64);
    let of_b = b.upload_capture_bytes(capture_zip()).await.unwrap();
    // A model may exceed the quota, because its size is not known in advance; then no further job is
    // accepted.
    let job = b.create_job(&small_job(&of_b.id, 3, 5), None).await.unwrap();
    ended(&b, &job.id).await;
    assert_eq!(refusal(b.create_job(&small_job(&of_b.id, 3, 5), None).await).0, 507);
    assert_eq!(refusal(b.retry_job(&job.id).await).0, 409);
}

type Pieces = UnboundedSender<Result<Vec<u8>, std::io::Error>>;

/// An upload whose chunks are sent one by one; it ends when the sender is dropped.
fn streamed(client: &Client, path: &str) -> (Pieces, JoinHandle<Result<Response, reqwest::Error>>) {
    let (pieces, body) = futures::channel::mpsc::unbounded();
    let request = client.request(Method::POST, path).unwrap().header("content-type", "application/zip");
    (pieces, tokio::spawn(request.body(reqwest::Body::wrap_stream(body)).send()))
}

/// Status and text of an answer.
async fn answered(upload: JoinHandle<Result<Response, reqwest::Error>>) -> (u16, String) {
    let answer = upload.await.unwrap().unwrap();
    (answer.status().as_u16(), answer.text().await.unwrap())
}

/// Waits until the staged uploads have this total size, bytes.
async fn until_on_disk(server: &TestServer, bytes: u64) {
    let folder = server.data_dir().join("artifacts/incoming");
    while files_under(&folder).iter().map(|(_, size)| size).sum::<u64>() < bytes {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn concurrent_uploads_together_respect_quota_and_disk_limit() {
    // Larger than the chunks in which uploads are written.
    const HALF: usize = 12 << 20;
    for (quota, limit) in [(Some(HALF as u64 * 3), None), (None, Some(HALF as u64 * 3))] {
        let server = server(|config| {
            config.quota = Quota { jobs: None, bytes: quota };
            config.limits.disk_bytes = limit;
        })
        .await;
        let a = of_tenant(&server, "a").await;
        let (first, uploading) = streamed(&a, "/v1/captures");
        first.unbounded_send(Ok(vec![1; HALF * 2])).unwrap();
        until_on_disk(&server, HALF as u64).await;
        for path in ["/v1/captures", "/v1/captures/validate"] {
            let (second, refused) = streamed(&a, path);
            second.unbounded_send(Ok(vec![2; HALF * 3 / 2])).unwrap();
            let (status, text) = answered(refused).await;
            assert_eq!(status, 507, "{path}: {text}");
        }
        drop(first);
        assert_eq!(answered(uploading).await.0, 422, "the first one arrived whole, and is no archive");
        assert!(files_under(server.data_dir()).is_empty());
        let (alone, uploading) = streamed(&a, "/v1/captures");
        alone.unbounded_send(Ok(vec![2; HALF * 3 / 2])).unwrap();
        drop(alone);
        assert_eq!(answered(uploading).await.0, 422, "the control: what has ended is given back");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_tenant_may_use_at_most_half_of_the_upload_slots() {
    let server = server(|_| {}).await;
    let (a, b) = (of_tenant(&server, "a").await, of_tenant(&server, "b").await);
    let mut held = Vec::new();
    for count in 1..=32 {
        let (pieces, upload) = streamed(&a, "/v1/captures");
        pieces.unbounded_send(Ok(vec![0])).unwrap();
        held.push((pieces, upload));
        let folder = server.data_dir().join("artifacts/incoming");
        while files_under(&folder).len() < count {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    }
    let refused = streamed(&a, "/v1/captures").1.await.unwrap().unwrap();
    assert_eq!((refused.status().as_u16(), told(&refused, "retry-after")), (503, "1".to_owned()));
    let text = refused.text().await.unwrap();
    assert!(text.contains("maximum of 32"), "{text}");
    b.upload_capture_bytes(capture_zip()).await.unwrap();
    for (pieces, upload) in held {
        drop(pieces);
        assert_eq!(answered(upload).await.0, 422);
    }
    a.upload_capture_bytes(capture_zip()).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn only_the_operator_sees_the_usage_of_all_tenants() {
    let size = capture_zip().len() as u64;
    let server = server(|config| config.limits.disk_bytes = Some(size + 10)).await;
    let (a, operator) = (of_tenant(&server, "a").await, bearer(&server, KEYS[0]));
    operator.upload_capture_bytes(capture_zip()).await.unwrap();
    let said = async |client: &Client| {
        let refused = client.upload_capture_bytes(CaptureZip::new(9, 32).zip()).await.unwrap_err();
        let problem = refused.problem().unwrap().clone();
        assert_eq!(problem.kind, "urn:relume:problem:storage-limit");
        problem.detail.unwrap()
    };
    let (to_a, to_operator) = (said(&a).await, said(&operator).await);
    assert!(to_operator.contains(&size.to_string()), "{to_operator}");
    assert!(!to_a.contains(|c: char| c.is_ascii_digit()), "{to_a}");
    let (of_a, of_operator) = (a.usage().await.unwrap(), operator.usage().await.unwrap());
    assert_eq!((of_operator.limit_bytes, of_operator.free_bytes.is_some()), (Some(size + 10), true));
    assert_eq!(of_a, relume_api::usage::Usage::default(), "nothing but what it has");
    // Only an administrator of the operator's tenant, not every key of it.
    let body = serde_json::json!({ "name": "x", "tenant": "default", "scopes": ["read"] });
    let request = operator.request(Method::POST, "/v1/keys").unwrap().json(&body).send().await.unwrap();
    let made: Value = serde_json::from_str(&request.text().await.unwrap()).unwrap();
    let reader = bearer(&server, made["secret"].as_str().unwrap());
    assert_eq!(reader.usage().await.unwrap().free_bytes, None);
}

#[tokio::test(flavor = "multi_thread")]
async fn logs_contain_key_id_and_tenant_but_not_the_secret() {
    let data = TempDir::new().unwrap();
    let store = Store::open(data.path()).await.unwrap();
    let key = NewKeyRecord {
        name: "logged".into(),
        tenant: TenantId::from("studio-a"),
        scopes: vec![Scope::Read],
        expires_ms: None,
        made_by: None,
    };
    let (key, secret) = store.create_key(&key, 0).await.unwrap();
    store.close().await;
    let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
    command.args(["serve", "--listen", "127.0.0.1:0", "--json-logs", "--data-dir"]).arg(data.path());
    command
        .env("RELUME_REQUESTS_PER_MINUTE", "1000")
        .env("RUST_LOG", "relume=info")
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let base = line.trim().strip_prefix("listening on ").unwrap().to_owned();
    let client = Client::new(&base, None).unwrap();
    for (bearer, id) in [(&*secret, "with-a-key"), ("wrong", "with-none")] {
        let request = client.request(Method::GET, "/v1/jobs").unwrap();
        let request =
            request.header("x-request-id", id).header(header::AUTHORIZATION, format!("Bearer {bearer}"));
        let answer = request.send().await.unwrap();
        let policy = if bearer == secret { "\"requests\";q=1000;w=60, \"tenant\";q=10000;w=60" } else { "" };
        assert_eq!(told(&answer, "ratelimit-policy"), policy, "as the variable says");
    }
    terminate(&child);
    let log: Vec<String> = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap).collect();
    child.wait().unwrap();
    let of = |id: &str| -> Value {
        let line = log.iter().find(|line| line.contains(id) && line.contains("answered"));
        serde_json::from_str(line.unwrap_or_else(|| panic!("{log:#?}"))).unwrap()
    };
    let known = of("with-a-key");
    assert_eq!(known["span"]["key"], key.id.as_str(), "{known}");
    assert_eq!(known["span"]["tenant"], "studio-a");
    assert_eq!(of("with-none")["span"]["key"], Value::Null);
    assert!(!log.iter().any(|line| line.contains(&secret[21..])));
}

/// Terminates a process with a signal, so that its log is complete.
fn terminate(child: &std::process::Child) {
    let asked = Command::new("kill").arg(child.id().to_string()).status().unwrap();
    assert!(asked.success());
}

#[tokio::test(flavor = "multi_thread")]
async fn tenants_take_turns_in_the_queue_of_jobs() {
    let server = server(|config| config.trainers = relume::server::Trainers::None).await;
    let (many, few) = (of_tenant(&server, "many").await, of_tenant(&server, "few").await);
    let submit = async |client: &Client, count: usize| {
        let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
        let mut jobs = Vec::new();
        for _ in 0..count {
            jobs.push(client.create_job(&small_job(&capture.id, 3, 5), None).await.unwrap().id);
        }
        jobs
    };
    let of_many = submit(&many, 5).await;
    let of_few = submit(&few, 2).await;
    let places = async |client: &Client, jobs: &[relume_api::JobId]| {
        let mut places = Vec::new();
        for job in jobs {
            places.push(client.job(job).await.unwrap().queue_position.unwrap());
        }
        places
    };
    assert_eq!(places(&many, &of_many).await, [0, 2, 4, 5, 6]);
    assert_eq!(places(&few, &of_few).await, [1, 3]);
    // The control: a higher priority goes first.
    let first = &of_many[4];
    let body = serde_json::json!({ "priority": 1 });
    let path = format!("/v1/jobs/{first}");
    let changed = many.request(Method::PATCH, &path).unwrap().json(&body).send().await.unwrap();
    assert_eq!(changed.status(), 200);
    assert_eq!(places(&many, &of_many).await, [1, 3, 5, 6, 0]);
}
