//! Web pages: the permitted origins, the headers that they can read, and the protection of a server without
//! keys.

use relume::server::{ApiKeys, CorsOrigin, ServerConfig};
use relume::testing::{self, TestServer};
use reqwest::{Method, RequestBuilder, StatusCode, header};
use serde_json::Value;
use tempfile::TempDir;

use crate::service_support::trained;

const KEY: &str = "a-key-for-this-test";

async fn server_with(change: impl FnOnce(&mut ServerConfig)) -> TestServer {
    testing::spawn_with(TempDir::new().unwrap(), change).await.unwrap()
}

fn listing(origin: &str) -> impl FnOnce(&mut ServerConfig) {
    let origin: CorsOrigin = origin.parse().unwrap();
    |config| config.cors_origins = vec![origin]
}

fn request(server: &TestServer, method: Method, path: &str) -> RequestBuilder {
    server.client().request(method, path).unwrap()
}

/// Status and problem type of an answer.
async fn outcome(request: RequestBuilder) -> (StatusCode, String) {
    let answer = request.send().await.unwrap();
    let status = answer.status();
    let body: Value = serde_json::from_str(&answer.text().await.unwrap()).unwrap_or_default();
    (status, body["type"].as_str().unwrap_or_default().replace("urn:relume:problem:", ""))
}

#[tokio::test(flavor = "multi_thread")]
async fn only_listed_origins_get_cors_headers() {
    let server = server_with(listing("https://app.example")).await;
    let from = |origin: &str| request(&server, Method::GET, "/healthz").header(header::ORIGIN, origin);
    let listed = from("https://app.example").send().await.unwrap();
    assert_eq!(listed.headers()[header::ACCESS_CONTROL_ALLOW_ORIGIN], "https://app.example");
    let other = from("https://evil.example").send().await.unwrap();
    assert!(
        other.headers().get(header::ACCESS_CONTROL_ALLOW_ORIGIN).is_none_or(|o| o != "https://evil.example")
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn cors_wildcard_allows_all_origins_without_credentials() {
    let server = server_with(|config| {
        config.cors_origins = vec!["*".parse().unwrap()];
        config.api_keys = ApiKeys::new([KEY]);
    })
    .await;
    let page = request(&server, Method::GET, "/healthz").header(header::ORIGIN, "https://any.example");
    let answer = page.send().await.unwrap();
    assert_eq!(answer.headers()[header::ACCESS_CONTROL_ALLOW_ORIGIN], "*");
    assert!(!answer.headers().contains_key(header::ACCESS_CONTROL_ALLOW_CREDENTIALS));
    let exposed = answer.headers()[header::ACCESS_CONTROL_EXPOSE_HEADERS].to_str().unwrap();
    for name in ["content-range", "etag", "location", "relume-depth-range", "retry-after"] {
        assert!(exposed.split(',').any(|e| e.eq_ignore_ascii_case(name)), "{name} in {exposed}");
    }
    let preflight = request(&server, Method::OPTIONS, "/v1/jobs")
        .header(header::ORIGIN, "https://any.example")
        .header(header::ACCESS_CONTROL_REQUEST_METHOD, "POST")
        .header(header::ACCESS_CONTROL_REQUEST_HEADERS, "authorization,content-type");
    let answer = preflight.send().await.unwrap();
    assert!(answer.status().is_success());
    let allowed = answer.headers()[header::ACCESS_CONTROL_ALLOW_HEADERS].to_str().unwrap();
    assert!(allowed.contains("authorization"), "{allowed}");
}

/// Headers that pages may always read (Fetch standard, CORS-safelisted response-header names), and those that are for the browser.
const NOT_EXPOSED: [&str; 10] = [
    "access-control-allow-origin",
    "access-control-expose-headers",
    "cache-control",
    "content-length",
    "content-security-policy",
    "content-type",
    "date",
    "referrer-policy",
    "vary",
    "x-content-type-options",
];

#[tokio::test(flavor = "multi_thread")]
async fn pages_may_read_every_header_of_an_answer() {
    let server = server_with(listing("https://app.example")).await;
    let model = trained(server.client()).await.model.unwrap();
    let file = format!("/v1/models/{model}/files/model.safetensors");
    for (path, status, own) in [
        (file, StatusCode::PARTIAL_CONTENT, "content-range"),
        (format!("/v1/models/{model}/thumbnail?size=16"), StatusCode::OK, "server-timing"),
        ("/v1/models/nobody".to_owned(), StatusCode::NOT_FOUND, "x-request-id"),
    ] {
        let page = request(&server, Method::GET, &path).header(header::ORIGIN, "https://app.example");
        let answer = page.header(header::RANGE, "bytes=0-9").send().await.unwrap();
        assert_eq!(answer.status(), status, "{path}");
        assert!(answer.headers().contains_key(own), "the control: {path}");
        let exposed = answer.headers()[header::ACCESS_CONTROL_EXPOSE_HEADERS].to_str().unwrap();
        let exposed: Vec<&str> = exposed.split(',').map(str::trim).collect();
        let names = answer.headers().keys().map(|name| name.as_str());
        let hidden: Vec<&str> =
            names.filter(|name| !NOT_EXPOSED.contains(name) && !exposed.contains(name)).collect();
        assert!(hidden.is_empty(), "{path}: {hidden:?}");
        assert!(!exposed.contains(&"date"), "the control: not everything is exposed");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_response_has_restrictive_security_headers() {
    let server = testing::spawn().await.unwrap();
    for path in ["/healthz", "/v1/models/nobody", "/nowhere"] {
        let answer = request(&server, Method::GET, path).send().await.unwrap();
        let found = |name| answer.headers().get(name).and_then(|v| v.to_str().ok()).unwrap_or_default();
        assert_eq!(found("x-content-type-options"), "nosniff", "{path}");
        assert_eq!(found("referrer-policy"), "no-referrer", "{path}");
        assert!(found("content-security-policy").contains("default-src 'none'"), "{path}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_key_a_foreign_host_header_is_refused() {
    let server = server_with(|config| config.allowed_hosts = vec!["studio.lan".into()]).await;
    let called = |host: &str| request(&server, Method::GET, "/v1/models").header(header::HOST, host);
    for own in ["localhost:7878", "127.0.0.1", "[::1]:80", "studio.lan"] {
        assert_eq!(outcome(called(own)).await.0, StatusCode::OK, "{own}");
    }
    for foreign in ["evil.example", "127.0.0.1.evil.example", "192.0.2.1:7878"] {
        let expected = (StatusCode::FORBIDDEN, "foreign-host".to_owned());
        assert_eq!(outcome(called(foreign)).await, expected, "{foreign}");
    }
    let locked = server_with(|config| config.api_keys = ApiKeys::new([KEY])).await;
    let called = request(&locked, Method::GET, "/v1/models").header(header::HOST, "relume.example");
    assert_eq!(outcome(called.bearer_auth(KEY)).await.0, StatusCode::OK, "the key protects");
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_key_cross_origin_requests_are_refused() {
    let server = server_with(listing("https://app.example")).await;
    let form = || reqwest::multipart::Form::new().text("archive", "not a zip");
    let upload = || request(&server, Method::POST, "/v1/captures").multipart(form());
    let refused = (StatusCode::FORBIDDEN, "foreign-origin".to_owned());
    let from = |origin: &str| upload().header(header::ORIGIN, origin);
    assert_eq!(outcome(from("https://evil.example")).await, refused);
    assert_eq!(outcome(from("null")).await, refused);
    assert_eq!(outcome(upload().header("sec-fetch-site", "cross-site")).await, refused);
    // Other requests are refused only because of the archive.
    let read = (StatusCode::UNPROCESSABLE_ENTITY, "invalid-content".to_owned());
    assert_eq!(outcome(from("https://app.example")).await, read);
    assert_eq!(outcome(upload()).await, read);
}
