//! Resumable uploads (tus 1.0.0): interrupted, killed, expired, of several tenants, concurrent.

use std::sync::Arc;
use std::time::Duration;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use relume::jobs::ManualClock;
use relume::server::{ApiKeys, ServerConfig};
use relume::store::{self, Quota, hex};
use relume::testing::{self, TestServer};
use relume_api::UploadId;
use relume_client::{Client, ClientError};
use reqwest::{Method, RequestBuilder, Response};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use tempfile::TempDir;

use crate::crash::noise;
use crate::server_process::Server;
use crate::service_support::{ALL_OF_A_TENANT, CaptureZip, capture_zip, files_under};

/// A capture of some size.
fn large_zip(noise_bytes: usize) -> Vec<u8> {
    let mut capture = CaptureZip::new(8, 32);
    capture.images.push(("noise.bin".to_owned(), noise(noise_bytes)));
    capture.zip()
}

pub fn tus(client: &Client, method: Method, path: &str) -> RequestBuilder {
    client.request(method, path).unwrap().header("tus-resumable", "1.0.0")
}

fn patch(client: &Client, id: &UploadId, offset: u64) -> RequestBuilder {
    let request = tus(client, Method::PATCH, &format!("/v1/uploads/{id}"));
    request.header("content-type", "application/offset+octet-stream").header("upload-offset", offset)
}

pub async fn send(request: RequestBuilder) -> Response {
    request.send().await.unwrap()
}

fn told(answer: &Response, name: &str) -> String {
    answer.headers().get(name).map(|v| v.to_str().unwrap().to_owned()).unwrap_or_default()
}

/// Status and problem type of a refusal.
pub fn refusal<T: std::fmt::Debug>(answer: Result<T, ClientError>) -> (u16, String) {
    let error = answer.expect_err("it is refused");
    let problem = error.problem().unwrap_or_else(|| panic!("{error}"));
    (problem.status, problem.kind.rsplit(':').next().unwrap().to_owned())
}

pub async fn offset(client: &Client, id: &UploadId) -> u64 {
    loop {
        match client.upload(id).await {
            // The client used a connection that the server had closed after a refusal.
            Err(ClientError::Transport(error)) if error.is_request() => {}
            found => return found.unwrap().offset,
        }
    }
}

/// Sends a chunk whose connection breaks at its end.
async fn cut(client: &Client, id: &UploadId, offset: u64, piece: &[u8]) {
    let broken = Err(std::io::Error::other("cut"));
    let pieces: Vec<_> = piece.chunks(9_999).map(|c| Ok(c.to_vec())).chain([broken]).collect();
    let body = reqwest::Body::wrap_stream(futures::stream::iter(pieces));
    assert!(patch(client, id, offset).body(body).send().await.is_err());
}

/// Every file below the artifacts.
pub fn artifacts(server: &TestServer) -> Vec<String> {
    files_under(&server.data_dir().join("artifacts")).into_iter().map(|(name, _)| name).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn an_upload_interrupted_anywhere_resumes_to_the_same_capture() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let archive = large_zip(3 << 20);
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let id = client.begin_upload(archive.len() as u64).await.unwrap();
    let (mut cuts, mut at) = (0, 0);
    while at < archive.len() {
        let end = (at + random.random_range(1..400_000)).min(archive.len());
        if random.random_bool(0.5) {
            cut(client, &id, at as u64, &archive[at..end]).await;
            cuts += 1;
        } else {
            match client.send_piece(&id, at as u64, archive[at..end].to_vec()).await {
                // The second case: the client used a connection that the server had closed after a refusal.
                Ok(_) | Err(ClientError::Transport(_)) => {}
                // The server has not noticed yet that the previous connection broke.
                Err(error) => assert!([409, 423].contains(&refusal::<()>(Err(error)).0)),
            }
        }
        at = usize::try_from(offset(client, &id).await).unwrap();
    }
    assert!(cuts > 3, "{cuts}");
    let capture = loop {
        match client.capture_of_upload(&id).await {
            Err(error) if error.problem().is_some_and(|p| p.kind.ends_with("upload-locked")) => continue,
            made => break made.unwrap(),
        }
    };
    assert_eq!(capture.sha256, hex(&Sha256::digest(&archive)));
    assert_eq!(artifacts(&server), [format!("captures/{}", capture.sha256)], "and nothing else is left");
    assert_eq!(refusal(client.upload(&id).await).0, 404);
    assert_eq!(refusal(client.capture_of_upload(&id).await), (422, "invalid-field".to_owned()));
    let server = testing::spawn_with(server.stop().await.unwrap(), |_| {}).await.unwrap();
    assert_eq!(server.client().captures().await.unwrap().items, [capture]);
}

#[tokio::test(flavor = "multi_thread")]
async fn kill_9_during_an_upload_keeps_all_acknowledged_bytes() {
    let data = TempDir::new().unwrap();
    let archive = large_zip(48 << 20);
    let mut server = Server::start(data.path());
    let id = server.client.begin_upload(archive.len() as u64).await.unwrap();
    let mut counted = 0;
    for _ in 0..2 {
        let (sender, body) = futures::channel::mpsc::unbounded::<Result<Vec<u8>, std::io::Error>>();
        let rest = archive[usize::try_from(counted).unwrap()..].to_vec();
        let half = rest.len() * 2 / 3;
        sender.unbounded_send(Ok(rest[..half].to_vec())).unwrap();
        let sending =
            tokio::spawn(patch(&server.client, &id, counted).body(reqwest::Body::wrap_stream(body)).send());
        let before = counted;
        while counted == before {
            tokio::time::sleep(Duration::from_millis(10)).await;
            counted = offset(&server.client, &id).await;
        }
        server.kill();
        assert!(sending.await.unwrap().is_err());
        drop(sender);
        server = Server::start(data.path());
        let now = offset(&server.client, &id).await;
        assert!(now >= counted && now < archive.len() as u64, "{now} after {counted}");
        let file = data.path().join(format!("artifacts/uploads/{id}"));
        assert_eq!(std::fs::metadata(&file).unwrap().len(), now, "what is not counted is not there");
        counted = now;
    }
    let rest = archive[usize::try_from(counted).unwrap()..].to_vec();
    assert_eq!(server.client.send_piece(&id, counted, rest).await.unwrap(), archive.len() as u64);
    server.kill();
    let server = Server::start(data.path());
    let capture = server.client.capture_of_upload(&id).await.unwrap();
    assert_eq!(capture.sha256, hex(&Sha256::digest(&archive)));
}

#[tokio::test(flavor = "multi_thread")]
async fn uploads_follow_the_tus_protocol() {
    let limit = |config: &mut ServerConfig| {
        config.limits.capture_bytes = 1000;
        config.cors_origins = vec!["https://app.example.org".parse().unwrap()];
    };
    let server = testing::spawn_with(TempDir::new().unwrap(), limit).await.unwrap();
    let client = server.client();
    let options = send(client.request(Method::OPTIONS, "/v1/uploads").unwrap()).await;
    assert!(options.status().is_success());
    for (name, value) in [
        ("tus-resumable", "1.0.0"),
        ("tus-version", "1.0.0"),
        ("tus-extension", "creation,creation-with-upload,checksum,expiration,termination"),
        ("tus-max-size", "1000"),
        ("tus-checksum-algorithm", "sha1,sha256"),
    ] {
        assert_eq!(told(&options, name), value, "{name}");
    }
    let create = || tus(client, Method::POST, "/v1/uploads");
    let metadata = "filename c2Nhbi56aXA=";
    let made = send(create().header("upload-length", 10).header("upload-metadata", metadata)).await;
    assert_eq!((made.status().as_u16(), told(&made, "tus-resumable")), (201, "1.0.0".to_owned()));
    let path = told(&made, "location");
    let id = UploadId::from(path.rsplit('/').next().unwrap());
    let head = send(tus(client, Method::HEAD, &path)).await;
    assert_eq!((head.status().as_u16(), told(&head, "cache-control")), (200, "no-store".to_owned()));
    assert_eq!(
        ["upload-offset", "upload-length", "upload-metadata"].map(|name| told(&head, name)),
        ["0", "10", metadata]
    );
    assert!(told(&head, "upload-expires").ends_with(" GMT"));
    assert_eq!(client.upload(&id).await.unwrap().filename.as_deref(), Some("scan.zip"));

    let old = send(client.request(Method::HEAD, &path).unwrap().header("tus-resumable", "0.2.2")).await;
    assert_eq!((old.status().as_u16(), told(&old, "tus-version")), (412, "1.0.0".to_owned()));
    let sum_of_another = "sha1 Kq5sNclPz7QV2+lfQIuc6R7oRu0=";
    for (request, status) in [
        (patch(client, &id, 3).body("hello"), 409),
        (patch(client, &id, 0).header("upload-checksum", sum_of_another).body("hell"), 460),
        (patch(client, &id, 0).header("upload-checksum", "md5 AAAA").body("hello"), 400),
        (patch(client, &id, 0).body("hello hello hello"), 413),
        (tus(client, Method::PATCH, &path).header("upload-offset", 0).body("hello"), 415),
        (create(), 400),
        (create().header("upload-length", 1001), 413),
        (create().header("upload-defer-length", 1), 400),
        (create().header("upload-length", 1).body("x"), 415),
    ] {
        let answer = send(request).await;
        assert_eq!((answer.status().as_u16(), told(&answer, "tus-resumable")), (status, "1.0.0".to_owned()));
        assert_eq!(told(&answer, "content-type"), "application/problem+json", "{status}");
        assert_eq!(offset(client, &id).await, 0, "{status}");
    }
    let digest = |bytes: &[u8]| STANDARD.encode(Sha256::digest(bytes));
    let sent = patch(client, &id, 0).header("upload-checksum", format!("sha1 {}", digest(b"hello")));
    assert_eq!(send(sent.body("hello")).await.status(), 400, "a digest of another length");
    let sha1 = "qvTGHdzF6KLavt4PO0gs2a6pQ00=";
    let sent =
        send(patch(client, &id, 0).header("upload-checksum", format!("sha1 {sha1}")).body("hello")).await;
    assert_eq!((sent.status().as_u16(), told(&sent, "upload-offset")), (204, "5".to_owned()));
    let sum = format!("sha256 {}", digest(b"world"));
    let last = tus(client, Method::POST, &path).header("x-http-method-override", "PATCH");
    let last = last.header("content-type", "application/offset+octet-stream").header("upload-offset", 5);
    let last = send(last.header("upload-checksum", sum).body("world")).await;
    assert_eq!((last.status().as_u16(), told(&last, "upload-offset")), (204, "10".to_owned()));

    let piece = |body: &'static str| {
        let request = create().header("content-type", "application/offset+octet-stream");
        request.header("upload-length", 10).body(body)
    };
    let begun = send(piece("hello")).await;
    assert_eq!((begun.status().as_u16(), told(&begun, "upload-offset")), (201, "5".to_owned()));
    let uploads = artifacts(&server).len();
    let wrong = send(piece("hello").header("upload-checksum", sum_of_another)).await;
    assert_eq!((wrong.status().as_u16(), artifacts(&server).len()), (460, uploads), "nothing was begun");
    assert_eq!(send(tus(client, Method::DELETE, &told(&begun, "location"))).await.status(), 204);
    assert_eq!(send(tus(client, Method::HEAD, &told(&begun, "location"))).await.status(), 404);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_interrupted_chunk_with_a_checksum_is_discarded() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let id = client.begin_upload(100).await.unwrap();
    client.send_piece(&id, 0, "kept").await.unwrap();
    let sum = format!("sha256 {}", STANDARD.encode(Sha256::digest([7; 96])));
    let pieces = [Ok(vec![7; 50]), Err(std::io::Error::other("cut"))];
    let body = reqwest::Body::wrap_stream(futures::stream::iter(pieces));
    let broken = patch(client, &id, 4).header("upload-checksum", &sum).body(body);
    assert!(broken.send().await.is_err());
    let whole = || patch(client, &id, 4).header("upload-checksum", &sum).body(vec![7; 96]);
    let mut answer = send(whole()).await;
    while answer.status() == 423 {
        answer = send(whole()).await;
    }
    assert_eq!((answer.status().as_u16(), told(&answer, "upload-offset")), (204, "100".to_owned()));
    let stored = std::fs::read(server.data_dir().join(format!("artifacts/uploads/{id}"))).unwrap();
    assert_eq!(stored, [&b"kept"[..], &[7; 96]].concat());
}

#[tokio::test(flavor = "multi_thread")]
async fn an_upload_of_an_invalid_capture_is_kept_until_it_expires() {
    let clock = Arc::new(ManualClock::default());
    let hands = clock.clone();
    let changed = move |config: &mut ServerConfig| {
        config.clock = hands;
        config.uploads.life = Duration::from_secs(3600);
    };
    let server = testing::spawn_with(TempDir::new().unwrap(), changed).await.unwrap();
    let client = server.client();
    let [id, other] = [client.begin_upload(9).await.unwrap(), client.begin_upload(9).await.unwrap()];
    assert_eq!(refusal(client.capture_of_upload(&id).await), (409, "upload-incomplete".to_owned()));
    client.send_piece(&id, 0, "no archi").await.unwrap();
    clock.advance(Duration::from_secs(3000));
    client.send_piece(&id, 8, "v").await.unwrap();
    assert_eq!(refusal(client.capture_of_upload(&id).await), (422, "invalid-content".to_owned()));
    clock.advance(Duration::from_secs(3000));
    assert_eq!(offset(client, &id).await, 9, "every piece keeps it for as long again");
    assert_eq!(refusal(client.upload(&other).await), (410, "upload-expired".to_owned()));
    clock.advance(Duration::from_secs(601));
    assert_eq!(refusal(client.upload(&id).await), (410, "upload-expired".to_owned()));
    assert_eq!(refusal(client.send_piece(&id, 9, "").await).0, 410);
    assert_eq!(refusal(client.capture_of_upload(&id).await).0, 422);
    // A deletion wakes the garbage collector.
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap().id;
    client.delete_capture(&capture, false).await.unwrap();
    while !artifacts(&server).is_empty() {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    assert_eq!(refusal(client.upload(&id).await).0, 404);
    assert_eq!(client.usage().await.unwrap().uploads.count, 0);
}

const OPERATOR: &str = "the-operators-own-key";

/// A client with a new key of a tenant.
async fn of_tenant(server: &TestServer, tenant: &str) -> Client {
    let base = server.client().base().as_str();
    let operator = Client::new(base, Some(OPERATOR.to_owned())).unwrap();
    let body = json!({ "name": "x", "tenant": tenant, "scopes": ALL_OF_A_TENANT });
    let made = send(operator.request(Method::POST, "/v1/keys").unwrap().json(&body)).await;
    let made: Value = serde_json::from_str(&made.text().await.unwrap()).unwrap();
    Client::new(base, made["secret"].as_str().map(str::to_owned)).unwrap()
}

async fn server_with_keys(change: impl FnOnce(&mut ServerConfig)) -> TestServer {
    let change = |config: &mut ServerConfig| {
        config.api_keys = ApiKeys::new([OPERATOR]);
        change(config);
    };
    testing::spawn_with(TempDir::new().unwrap(), change).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn resumable_uploads_are_private_and_count_towards_the_quota() {
    let archive = large_zip(60_000);
    let length = archive.len() as u64;
    let most = length * 3 / 2;
    let server = server_with_keys(|config| {
        config.quota = Quota { jobs: None, bytes: Some(most) };
        config.uploads.each = 2;
    })
    .await;
    let (a, b) = (of_tenant(&server, "a").await, of_tenant(&server, "b").await);
    assert_eq!(refusal(a.begin_upload(most + 1).await), (507, "quota-exceeded".to_owned()));
    let [first, second] = [a.begin_upload(length).await.unwrap(), a.begin_upload(length).await.unwrap()];
    assert_eq!(refusal(a.begin_upload(1).await), (429, "quota-exceeded".to_owned()));
    let of_b = b.begin_upload(length).await.unwrap();
    for id in [&first, &second] {
        assert_eq!(refusal(b.upload(id).await).0, 404);
        assert_eq!(refusal(b.send_piece(id, 0, "x").await).0, 404);
        assert_eq!(refusal(b.capture_of_upload(id).await).0, 422);
        assert_eq!(refusal(b.delete_upload(id).await).0, 404);
    }
    a.send_piece(&first, 0, archive.clone()).await.unwrap();
    assert_eq!(refusal(a.send_piece(&second, 0, archive.clone()).await), (507, "quota-exceeded".to_owned()));
    let usage = a.usage().await.unwrap();
    assert!(usage.uploads.count == 2 && (length..=most).contains(&usage.uploads.bytes), "{usage:?}");
    assert_eq!(refusal(a.upload_capture_bytes(archive.clone()).await).0, 507, "other uploads meet it, too");

    // A capture replaces its upload.
    let capture = a.capture_of_upload(&first).await.unwrap();
    let usage = a.usage().await.unwrap();
    assert_eq!((usage.captures.bytes, usage.uploads.count), (length, 1));
    // The same content again: the server returns the existing capture, independent of the quota.
    a.delete_capture(&capture.id, false).await.unwrap();
    let at = offset(&a, &second).await;
    let rest = archive[usize::try_from(at).unwrap()..].to_vec();
    a.send_piece(&second, at, rest).await.unwrap();
    a.capture_of_upload(&second).await.unwrap();
    b.send_piece(&of_b, 0, archive).await.unwrap();
    assert_eq!(b.capture_of_upload(&of_b).await.unwrap().sha256, capture.sha256);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_concurrent_request_on_an_upload_answers_423() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let id = client.begin_upload(10).await.unwrap();
    let (sender, body) = futures::channel::mpsc::unbounded::<Result<Vec<u8>, std::io::Error>>();
    sender.unbounded_send(Ok(b"hello".to_vec())).unwrap();
    let first = tokio::spawn(patch(client, &id, 0).body(reqwest::Body::wrap_stream(body)).send());
    let file = server.data_dir().join(format!("artifacts/uploads/{id}"));
    while std::fs::metadata(&file).unwrap().len() < 5 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    assert_eq!(refusal(client.send_piece(&id, 0, "HELLO").await), (423, "upload-locked".to_owned()));
    assert_eq!(refusal(client.delete_upload(&id).await).0, 423);
    assert_eq!(refusal(client.capture_of_upload(&id).await), (409, "upload-locked".to_owned()));
    drop(sender);
    assert_eq!(first.await.unwrap().unwrap().status(), 204);
    assert_eq!(refusal(client.send_piece(&id, 0, "HELLO").await), (409, "offset-mismatch".to_owned()));
    assert_eq!(client.send_piece(&id, 5, "world").await.unwrap(), 10);
    assert_eq!(std::fs::read(file).unwrap(), b"helloworld");
}

#[tokio::test(flavor = "multi_thread")]
async fn concurrent_requests_make_one_capture_of_an_upload() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let archive = capture_zip();
    let id = client.begin_upload(archive.len() as u64).await.unwrap();
    let capture = format!("captures/{}", hex(&Sha256::digest(&archive)));
    client.send_piece(&id, 0, archive).await.unwrap();
    // The file that an earlier attempt left when its transaction failed.
    let stored = server.data_dir().join("artifacts");
    std::fs::create_dir_all(stored.join("captures")).unwrap();
    std::fs::hard_link(stored.join(format!("uploads/{id}")), stored.join(&capture)).unwrap();
    let asked = futures::future::join_all((0..8).map(|_| client.capture_of_upload(&id))).await;
    let (made, refused): (Vec<_>, Vec<_>) = asked.into_iter().partition(Result::is_ok);
    assert_eq!(made.len(), 1, "{made:?}");
    assert!(refused.into_iter().all(|answer| [409, 422].contains(&refusal(answer).0)));
    assert_eq!(client.captures().await.unwrap().items.len(), 1);
    assert_eq!(artifacts(&server), [capture]);
}

#[tokio::test(flavor = "multi_thread")]
async fn startup_restores_upload_offsets_and_backups_omit_uploads() {
    let server = testing::spawn().await.unwrap();
    let (client, data) = (server.client(), server.data_dir().to_owned());
    let [kept, lost] = [client.begin_upload(9).await.unwrap(), client.begin_upload(9).await.unwrap()];
    client.send_piece(&kept, 0, "some").await.unwrap();
    let folder = TempDir::new().unwrap();
    let copy = folder.path().join("copy");
    let database = testing::database_of(&data).await.unwrap();
    store::backup(&data, database.as_ref(), &copy, 0).await.unwrap();
    let restored = folder.path().join("restored");
    store::restore(&copy, &restored).await.unwrap();
    assert!(files_under(&restored).is_empty() && store::inspect(&restored).await.unwrap().faults.is_empty());
    assert!(store::inspect(&data).await.unwrap().orphans.is_empty());

    let dir = server.stop().await.unwrap();
    let uploads = data.join("artifacts/uploads");
    std::fs::write(uploads.join("01890000-0000-7000-8000-000000000000"), "of nobody").unwrap();
    std::fs::remove_file(uploads.join(lost.as_str())).unwrap();
    let found = store::inspect(&data).await.unwrap();
    assert!(found.faults.len() == 1 && found.faults[0].contains("is missing"), "{found:?}");
    assert_eq!(found.orphans.len(), 1, "{found:?}");
    // More bytes than are recorded.
    std::fs::write(uploads.join(kept.as_str()), "some that no one counted").unwrap();
    let server = testing::spawn_with(dir, |_| {}).await.unwrap();
    assert_eq!(offset(server.client(), &kept).await, 4);
    assert_eq!(refusal(server.client().upload(&lost).await).0, 404);
    assert_eq!(artifacts(&server), [format!("uploads/{kept}")]);
    assert_eq!(std::fs::read(uploads.join(kept.as_str())).unwrap(), b"some");
}
