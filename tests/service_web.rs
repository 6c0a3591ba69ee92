//! The web app: its files and their headers, and the unchanged headers of the API.

use std::io::Read;

use flate2::read::GzDecoder;
use relume::server::ApiKeys;
use relume::testing::{self, TestServer};
use reqwest::{Method, RequestBuilder, Response, StatusCode, header};
use tempfile::TempDir;

fn request(server: &TestServer, path: &str) -> RequestBuilder {
    server.client().request(Method::GET, path).unwrap()
}

async fn get(server: &TestServer, path: &str) -> Response {
    request(server, path).send().await.unwrap()
}

fn header_of(answer: &Response, name: header::HeaderName) -> String {
    answer.headers().get(name).and_then(|value| value.to_str().ok()).unwrap_or_default().to_owned()
}

/// The page and the paths below `assets/` that it names.
async fn page(server: &TestServer) -> (String, Vec<String>) {
    let html = get(server, "/").await.text().await.unwrap();
    let named = html.split('"').filter_map(|part| part.strip_prefix("./assets/"));
    let named: Vec<_> = named.map(|name| format!("/assets/{name}")).collect();
    assert!(!named.is_empty(), "{html}");
    (html, named)
}

#[tokio::test(flavor = "multi_thread")]
async fn content_security_policy_allows_only_the_pages_own_files() {
    let server = testing::spawn().await.unwrap();
    let answer = get(&server, "/").await;
    assert_eq!(header_of(&answer, header::CONTENT_TYPE), "text/html; charset=utf-8");
    assert_eq!(header_of(&answer, header::X_CONTENT_TYPE_OPTIONS), "nosniff");
    assert_eq!(header_of(&answer, header::REFERRER_POLICY), "no-referrer");
    let policy = header_of(&answer, header::CONTENT_SECURITY_POLICY);
    let directives: Vec<_> = policy.split(';').map(str::trim).collect();
    for needed in [
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "connect-src 'self'",
        "img-src 'self' blob: data:",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    ] {
        assert!(directives.contains(&needed), "{needed} in {policy}");
    }
    assert!(!policy.contains("unsafe"), "{policy}");
    let html = answer.text().await.unwrap();
    for inline in ["<style", "style=", "onload=", "onclick=", "<script>"] {
        assert!(!html.contains(inline), "{inline} in {html}");
    }
    // The content security policy of other answers remains strict.
    let api = get(&server, "/v1/models").await;
    assert_eq!(
        header_of(&api, header::CONTENT_SECURITY_POLICY),
        "default-src 'none'; frame-ancestors 'none'"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn hashed_web_files_are_immutable_and_others_are_revalidated() {
    let server = testing::spawn().await.unwrap();
    let (_, named) = page(&server).await;
    for path in &named {
        let answer = get(&server, path).await;
        assert_eq!(answer.status(), StatusCode::OK, "{path}");
        assert_eq!(
            header_of(&answer, header::CACHE_CONTROL),
            "public, max-age=31536000, immutable",
            "{path}"
        );
    }
    for path in ["/", "/docs", "/relume-viewer.js", "/favicon.svg"] {
        let answer = get(&server, path).await;
        assert_eq!(answer.status(), StatusCode::OK, "{path}");
        assert_eq!(header_of(&answer, header::CACHE_CONTROL), "no-cache", "{path}");
        let tag = header_of(&answer, header::ETAG);
        let again = request(&server, path).header(header::IF_NONE_MATCH, format!("\"other\", {tag}"));
        let again = again.send().await.unwrap();
        assert_eq!(again.status(), StatusCode::NOT_MODIFIED, "{path}");
        assert_eq!(header_of(&again, header::ETAG), tag);
        assert!(again.bytes().await.unwrap().is_empty());
        let changed = request(&server, path).header(header::IF_NONE_MATCH, "\"other\"").send().await.unwrap();
        assert_eq!(changed.status(), StatusCode::OK, "{path}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn scripts_are_compressed_if_the_client_accepts_gzip() {
    let server = testing::spawn().await.unwrap();
    let (_, named) = page(&server).await;
    let script = named.iter().find(|path| path.ends_with(".js")).unwrap();
    let plain = get(&server, script).await;
    assert!(!plain.headers().contains_key(header::CONTENT_ENCODING));
    let packed = request(&server, script).header(header::ACCEPT_ENCODING, "br, gzip");
    let packed = packed.send().await.unwrap();
    assert_eq!(header_of(&packed, header::CONTENT_ENCODING), "gzip");
    for answer in [&plain, &packed] {
        assert_eq!(header_of(answer, header::CONTENT_TYPE), "text/javascript; charset=utf-8");
        assert_eq!(header_of(answer, header::VARY), "accept-encoding");
    }
    assert_ne!(header_of(&plain, header::ETAG), header_of(&packed, header::ETAG));
    let (plain, packed) = (plain.bytes().await.unwrap(), packed.bytes().await.unwrap());
    assert!(packed.len() < plain.len());
    let mut unpacked = Vec::new();
    GzDecoder::new(&*packed).read_to_end(&mut unpacked).unwrap();
    assert_eq!(unpacked, plain);
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_are_public_when_the_api_needs_a_key() {
    let server =
        testing::spawn_with(TempDir::new().unwrap(), |config| config.api_keys = ApiKeys::new(["a-key"]));
    let server = server.await.unwrap();
    let (_, named) = page(&server).await;
    let paths = ["/", "/docs", "/relume-viewer.js", "/favicon.svg"]
        .into_iter()
        .chain(named.iter().map(String::as_str));
    for path in paths {
        assert_eq!(get(&server, path).await.status(), StatusCode::OK, "{path}");
    }
    for path in ["/v1/models", "/v1/captures", "/metrics", "/index.html"] {
        assert_eq!(get(&server, path).await.status(), StatusCode::UNAUTHORIZED, "{path}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn unknown_web_paths_answer_with_a_problem() {
    let server = testing::spawn().await.unwrap();
    for path in ["/assets/nothing-0000.js", "/assets/", "/assets/..%2Findex.html", "/src/main.tsx", "/v1"] {
        let answer = get(&server, path).await;
        assert_eq!(answer.status(), StatusCode::NOT_FOUND, "{path}");
        assert_eq!(header_of(&answer, header::CONTENT_TYPE), "application/problem+json", "{path}");
    }
    let posted = server.client().request(Method::POST, "/").unwrap().send().await.unwrap();
    assert_eq!(posted.status(), StatusCode::METHOD_NOT_ALLOWED);
}

#[tokio::test(flavor = "multi_thread")]
async fn browsers_are_sent_from_unknown_paths_to_the_web_app() {
    // With keys: the page itself asks for one.
    let keys = |config: &mut relume::server::ServerConfig| config.api_keys = ApiKeys::new(["a-key"]);
    let locked = testing::spawn_with(TempDir::new().unwrap(), keys).await.unwrap();
    let server = testing::spawn().await.unwrap();
    let browser = "text/html,application/xhtml+xml,*/*;q=0.8";
    let shown = request(&server, "/models/none").header(header::ACCEPT, browser).send().await.unwrap();
    assert_eq!((shown.status(), shown.url().path()), (StatusCode::OK, "/"));
    let asked = request(&locked, "/models/none").header(header::ACCEPT, browser).send().await.unwrap();
    assert_eq!((asked.status(), asked.url().path()), (StatusCode::OK, "/"));
    assert_eq!(get(&locked, "/models/none").await.status(), StatusCode::UNAUTHORIZED);
    assert_eq!(get(&server, "/models/none").await.status(), StatusCode::NOT_FOUND);
    let api = request(&server, "/v1/none").header(header::ACCEPT, browser).send().await.unwrap();
    assert_eq!(api.status(), StatusCode::NOT_FOUND);
}
