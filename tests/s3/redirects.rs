//! Redirects of callers to the bucket.

use relume::server::ServerConfig;
use relume::store::ArtifactsRedirect;
use relume::testing::TestServer;
use relume_api::jobs::JobState;
use reqwest::redirect::Policy;
use reqwest::{Method, Response, StatusCode};
use sha2::{Digest, Sha256};
use tempfile::TempDir;

use super::bucket::Bucket;
use super::server;
use crate::service_support::{small_job, trained};
use crate::workers::fleet::{Process, model_hash, undisturbed, upload, without_workers};

/// A server that redirects its callers to the bucket.
async fn redirecting(bucket: &Bucket, redirect: ArtifactsRedirect) -> TestServer {
    let change = |config: &mut ServerConfig| config.artifacts.as_mut().unwrap().redirect = Some(redirect);
    server(bucket, TempDir::new().unwrap(), change).await
}

/// Requests a file from a server without following redirects.
async fn ask(server: &TestServer, method: Method, path: &str, headers: &[(&str, &str)]) -> Response {
    let client = reqwest::Client::builder().redirect(Policy::none()).build().unwrap();
    let url = server.client().base().join(path).unwrap();
    let request = client.request(method, url);
    headers.iter().fold(request, |request, (name, value)| request.header(*name, *value)).send().await.unwrap()
}

fn location(answer: &Response) -> &str {
    answer.headers()["location"].to_str().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn downloads_are_redirected_to_the_bucket_where_possible() {
    let bucket = Bucket::start().await;
    let server = redirecting(&bucket, ArtifactsRedirect::Same).await;
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let path = format!("/v1/models/{model}/files/model.ply");
    let expected = client.model(&model).await.unwrap().files;
    let expected = &expected.iter().find(|file| file.name == "model.ply").unwrap().sha256;
    let hash =
        |bytes: &[u8]| -> String { Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect() };

    let answer = ask(&server, Method::GET, &path, &[]).await;
    assert_eq!(answer.status(), StatusCode::TEMPORARY_REDIRECT);
    assert_eq!(answer.headers()["etag"], format!("\"{expected}\""));
    assert_eq!(answer.headers()["cache-control"], "no-store");
    let there = location(&answer).to_owned();
    assert!(there.contains("/bucket/relume/test/attempts/"), "{there}");
    // The bucket does not know the caller: the URL alone grants access.
    let whole = reqwest::get(&there).await.unwrap().bytes().await.unwrap();
    assert_eq!(&hash(&whole), expected);
    let range = reqwest::Client::new().get(&there).header("range", "bytes=3-8").send().await.unwrap();
    assert_eq!((range.status().as_u16(), &range.bytes().await.unwrap()[..]), (206, &whole[3..9]));
    let (bare, query) = there.split_once('?').unwrap();
    assert_eq!(reqwest::get(bare).await.unwrap().status(), 403, "the control");
    let other = bare.replace("model.ply", "model.safetensors");
    let forged = reqwest::get(format!("{other}?{query}")).await.unwrap();
    assert_eq!(forged.status(), 403, "it is signed for one file");

    let served = [
        (Method::HEAD, vec![], 200),
        (Method::GET, vec![("sec-fetch-mode", "cors")], 200),
        (Method::GET, vec![("if-none-match", answer.headers()["etag"].to_str().unwrap())], 304),
        (Method::GET, vec![("sec-fetch-mode", "navigate")], 200),
    ];
    for (method, headers, status) in served {
        let answer = ask(&server, method.clone(), &path, &headers).await;
        assert_eq!(answer.status(), status, "{method} {headers:?}");
    }
    let before = bucket.faults.count("GET attempts/");
    assert_eq!(client.file(&model, "model.ply").await.unwrap(), whole);
    let (folder, gone) = (TempDir::new().unwrap(), before + 1);
    assert_eq!(bucket.faults.count("GET attempts/"), gone, "the client goes there");
    client.download(&model, "model.ply", &folder.path().join("m.ply")).await.unwrap();
    assert_eq!(std::fs::read(folder.path().join("m.ply")).unwrap(), whole);
}

#[tokio::test(flavor = "multi_thread")]
async fn redirects_use_the_configured_public_endpoint() {
    let bucket = Bucket::start().await;
    let there = ArtifactsRedirect::Endpoint("https://objects.example.com".to_owned());
    let server = redirecting(&bucket, there).await;
    let model = trained(server.client()).await.model.unwrap();
    let answer = ask(&server, Method::GET, &format!("/v1/models/{model}/files/model.ply"), &[]).await;
    let there = location(&answer);
    assert!(there.starts_with("https://objects.example.com/bucket/relume/test/attempts/"), "{there}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_fetches_its_capture_from_the_bucket() {
    let job = |capture: &_| small_job(capture, 60, 10);
    let expected = undisturbed(job).await;
    for redirect in [None, Some(ArtifactsRedirect::Same)] {
        let bucket = Bucket::start().await;
        let goes = redirect.is_some();
        let change = |config: &mut ServerConfig| {
            without_workers(config);
            config.artifacts.as_mut().unwrap().redirect = redirect;
        };
        let server = server(&bucket, TempDir::new().unwrap(), change).await;
        let capture = upload(server.client()).await;
        let id = server.client().create_job(&job(&capture), None).await.unwrap().id;
        let folder = TempDir::new().unwrap();
        let _worker = Process::start(server.client(), folder.path(), &[]);
        assert_eq!(model_hash(server.client(), &id).await, expected);
        assert_eq!(server.client().job(&id).await.unwrap().state, JobState::Succeeded);
        assert_eq!(bucket.faults.count("GET captures/"), usize::from(goes));
    }
}
