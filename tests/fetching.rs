//! Captures that the server fetches: only from permitted origins, within limits, and without remains after a
//! failure.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::{StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use futures::StreamExt;
use relume::server::ServerConfig;
use relume::testing::{self, TestServer};
use relume_api::uploads::CaptureSource;
use reqwest::Method;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::service_support::{capture_zip, files_under};

/// A file server that counts its requests.
struct Source {
    origin: String,
    asked: Arc<AtomicUsize>,
}

impl Source {
    async fn new() -> Self {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let origin = format!("http://{}", listener.local_addr().unwrap());
        let asked = Arc::<AtomicUsize>::default();
        let app = Router::new().fallback(give).with_state(asked.clone());
        tokio::spawn(async move { axum::serve(listener, app).await });
        Self { origin, asked }
    }

    fn asked(&self) -> usize {
        self.asked.load(Ordering::SeqCst)
    }
}

async fn give(State(asked): State<Arc<AtomicUsize>>, uri: Uri) -> Response {
    asked.fetch_add(1, Ordering::SeqCst);
    let piece = || Ok::<_, std::io::Error>(Bytes::from_static(&[b'x'; 4096]));
    let forever = || futures::stream::repeat_with(piece);
    match uri.path() {
        "/capture.zip" => capture_zip().into_response(),
        "/moved" => (StatusCode::FOUND, [(header::LOCATION, "/capture.zip")]).into_response(),
        "/endless" => Body::from_stream(forever()).into_response(),
        "/long" => ([(header::CONTENT_LENGTH, "99999999")], Body::from_stream(forever())).into_response(),
        "/cut" => {
            let torn = futures::stream::once(async {
                // The delay makes sure that the first part has been sent.
                tokio::time::sleep(Duration::from_millis(50)).await;
                Err(std::io::Error::other("torn"))
            });
            Body::from_stream(forever().take(3).chain(torn)).into_response()
        }
        "/silent" => {
            Body::from_stream(futures::stream::pending::<Result<Bytes, std::io::Error>>()).into_response()
        }
        "/never" => std::future::pending().await,
        "/packed" => ([(header::CONTENT_ENCODING, "gzip")], capture_zip()).into_response(),
        "/junk" => "no archive".into_response(),
        _ => StatusCode::NOT_FOUND.into_response(),
    }
}

/// A server that fetches from `origin`, with the configuration changed by `change`.
async fn server(origin: &str, change: impl FnOnce(&mut ServerConfig)) -> TestServer {
    let config = |config: &mut ServerConfig| {
        config.fetching.origins = vec![origin.parse().unwrap()];
        config.fetching.allow_private = true;
        config.fetching.stall = Duration::from_millis(500);
        change(config);
    };
    testing::spawn_with(TempDir::new().unwrap(), config).await.unwrap()
}

/// Status and body of the answer to a request for a capture of `source`.
async fn make(server: &TestServer, source: Value) -> (u16, Value) {
    let request = server.client().request(Method::POST, "/v1/captures").unwrap().json(&source);
    let answer = request.send().await.unwrap();
    (answer.status().as_u16(), serde_json::from_str(&answer.text().await.unwrap()).unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_capture_is_fetched_once_from_a_url_and_hash_checked() {
    let source = Source::new().await;
    let server = server(&source.origin, |_| {}).await;
    let url = format!("{}/capture.zip?token=a", source.origin);
    let wrong = make(&server, json!({"url": url, "sha256": "0".repeat(64)})).await;
    assert_eq!((wrong.0, &wrong.1["errors"][0]["pointer"]), (422, &json!("/sha256")), "{wrong:?}");
    assert!(files_under(server.data_dir()).is_empty());

    let no_hash = make(&server, json!({"url": url, "sha256": "abc"})).await;
    assert_eq!((no_hash.0, &no_hash.1["errors"][0]["pointer"]), (422, &json!("/sha256")), "{no_hash:?}");
    assert_eq!(source.asked(), 1, "what cannot be asked for is not fetched");

    let made = make(&server, json!({"url": url})).await;
    assert_eq!(made.0, 201, "{made:?}");
    let again = make(&server, json!({"url": url, "sha256": made.1["sha256"]})).await;
    assert_eq!((again.0, &again.1["id"]), (200, &made.1["id"]));
    let sent = server.client().upload_capture_bytes(capture_zip()).await.unwrap();
    assert_eq!(json!(sent.id), made.1["id"], "the same bytes");
    let fetched = server.client().capture_of(&CaptureSource::url(&url)).await.unwrap();
    assert_eq!(fetched.id, sent.id);
    assert_eq!(source.asked(), 4);

    let later = server.client().request(Method::POST, "/v1/captures?name=later").unwrap();
    let later =
        later.header("prefer", "respond-async").json(&json!({"url": format!("{}/junk", source.origin)}));
    assert_eq!(later.send().await.unwrap().status(), 202, "it is validated when it is there");
    let validated = server.client().request(Method::POST, "/v1/captures/validate").unwrap();
    let validated = validated.json(&json!({"url": url})).send().await.unwrap();
    assert_eq!(validated.status(), 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_sample_is_a_capture_that_the_server_makes_once() {
    let server = server("https://a.example", |_| {}).await;
    let made = make(&server, json!({"sample": true})).await;
    assert_eq!(made.0, 201, "{made:?}");
    assert_eq!(made.1["report"]["train_images"], 20);
    let again = make(&server, json!({"sample": true, "sha256": made.1["sha256"]})).await;
    assert_eq!((again.0, &again.1["id"]), (200, &made.1["id"]), "{again:?}");
    let both = make(&server, json!({"sample": true, "url": "https://a.example/"})).await;
    assert!(both.0 == 422 && both.1.to_string().contains("/sample"), "{both:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_upload_with_a_wrong_hash_is_refused_and_kept() {
    let server = testing::spawn().await.unwrap();
    let (client, archive) = (server.client(), capture_zip());
    let id = client.begin_upload(archive.len() as u64).await.unwrap();
    client.send_piece(&id, 0, archive).await.unwrap();
    let wrong = make(&server, json!({"upload": id, "sha256": "0".repeat(64)})).await;
    assert_eq!((wrong.0, &wrong.1["errors"][0]["pointer"]), (422, &json!("/sha256")), "{wrong:?}");
    let found = wrong.1["errors"][0]["detail"].as_str().unwrap().rsplit(' ').next().unwrap();
    let made = make(&server, json!({"upload": id, "sha256": found})).await;
    assert_eq!((made.0, &made.1["sha256"]), (201, &json!(found)), "{made:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn fetching_from_origins_that_are_not_allowed_is_refused() {
    let (source, other) = (Source::new().await, Source::new().await);
    let by_name = source.origin.replace("127.0.0.1", "localhost");
    let strict = server(&by_name, |config| config.fetching.allow_private = false).await;
    let open = server(&source.origin, |_| {}).await;
    let none = testing::spawn().await.unwrap();
    for (server, url, status, word) in [
        (&none, format!("{}/capture.zip", source.origin), 422, "fetching is not configured"),
        (&open, format!("{}/capture.zip", other.origin), 422, "not among the origins"),
        (&open, format!("{by_name}/capture.zip"), 422, "not among the origins"),
        (&open, source.origin.replace("http:", "https:") + "/capture.zip", 422, "not among the origins"),
        (&open, source.origin.replace("//", "//user@") + "/capture.zip", 422, "user name"),
        (&open, "file:///etc/passwd".to_owned(), 422, "must be a URL"),
        (&strict, format!("{by_name}/capture.zip"), 502, "no public address"),
    ] {
        let refused = make(server, json!({"url": url})).await;
        assert_eq!(refused.0, status, "{url}: {refused:?}");
        assert!(refused.1.to_string().contains(word), "{url}: {refused:?}");
        assert!(files_under(server.data_dir()).is_empty());
    }
    assert_eq!((source.asked(), other.asked()), (0, 0));
    for (source, pointer) in
        [(json!({}), "/upload"), (json!({"url": "https://a.example/", "upload": "x"}), "/url")]
    {
        let refused = make(&open, source).await;
        assert_eq!((refused.0, &refused.1["errors"][0]["pointer"]), (422, &json!(pointer)), "{refused:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_failed_fetch_reports_the_cause_and_leaves_nothing() {
    let source = Source::new().await;
    let server = server(&source.origin, |config| config.limits.capture_bytes = 1 << 20).await;
    for (path, status, word) in [
        ("/missing", 502, "answered 404"),
        ("/moved", 502, "redirects are not followed"),
        ("/never", 502, "did not answer in time"),
        ("/silent", 502, "in time"),
        ("/cut", 502, "the connection broke"),
        ("/packed", 502, "encoding"),
        ("/endless", 413, "1048576"),
        ("/long", 413, "1048576"),
        ("/junk", 422, "archive"),
    ] {
        let asked = source.asked();
        let refused = make(&server, json!({"url": format!("{}{path}", source.origin)})).await;
        assert_eq!(refused.0, status, "{path}: {refused:?}");
        assert!(refused.1.to_string().contains(word), "{path}: {refused:?}");
        assert_eq!(source.asked(), asked + 1, "{path} is asked for once");
        assert!(files_under(server.data_dir()).is_empty(), "{path}");
    }
    assert_eq!(
        make(&server, json!({"url": format!("{}/capture.zip", source.origin)})).await.0,
        201,
        "the control"
    );
}
