//! Captures that are validated after the answer (RFC 7240, `Prefer: respond-async`).

use std::collections::BTreeMap;
use std::io::{Cursor, Write};
use std::time::Duration;

use relume::store::hex;
use relume::testing;
use relume_api::captures::{CaptureState, CaptureSummary};
use relume_api::jobs::NewJob;
use relume_api::metadata::{MetadataChange, ResourceMetadata};
use relume_api::uploads::CaptureSource;
use relume_capture::formats::image_file::encode_png;
use relume_client::Client;
use reqwest::{Method, Response};
use serde_json::json;
use sha2::{Digest, Sha256};
use tempfile::TempDir;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use crate::server_process::Server;
use crate::service_support::{CaptureZip, capture_zip, ended, files_under, raw_pool, small_job};

/// A capture whose photographs take a while to decode.
fn slow_zip() -> Vec<u8> {
    let capture = CaptureZip::new(4, 32);
    let large = encode_png(5000, 5000, &vec![[90, 60, 30, 255]; 25_000_000]).unwrap();
    // Stored uncompressed: a file with such a compression ratio is refused as a bomb.
    let stored = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let transforms = serde_json::to_vec(&capture.transforms).unwrap();
    let photographs = capture.images.iter().map(|(name, _)| (name.as_str(), &large));
    for (name, bytes) in [("transforms_train.json", &transforms)].into_iter().chain(photographs) {
        zip.start_file(name, stored).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

async fn post_later(client: &Client, archive: Vec<u8>) -> Response {
    post_called(client, "", archive).await
}

/// As [`post_later`], with the metadata of the capture in a query.
async fn post_called(client: &Client, query: &str, archive: Vec<u8>) -> Response {
    let request = client.request(Method::POST, &format!("/v1/captures{query}")).unwrap();
    let request = request.header("content-type", "application/zip").header("prefer", "respond-async");
    request.body(archive).send().await.unwrap()
}

/// The capture in a 202 answer.
async fn accepted(answer: Response) -> CaptureSummary {
    let told = |name: &str| answer.headers()[name].to_str().unwrap().to_owned();
    assert_eq!((answer.status().as_u16(), told("preference-applied").as_str()), (202, "respond-async"));
    let location = told("location");
    let view: CaptureSummary = serde_json::from_str(&answer.text().await.unwrap()).unwrap();
    assert_eq!(location, format!("/v1/captures/{}", view.id));
    assert_eq!(view.state, CaptureState::Validating);
    view
}

/// The capture once it is validated.
async fn validated(client: &Client, begun: &CaptureSummary) -> CaptureSummary {
    for _ in 0..3000 {
        let view = client.capture(&begun.id).await.unwrap();
        if view.state != CaptureState::Validating {
            return view;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    panic!("{begun:?} is never validated");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_asynchronous_capture_reports_its_validation_state() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let archive = slow_zip();
    let begun = accepted(post_later(client, archive.clone()).await).await;
    assert_eq!(begun.sha256, hex(&Sha256::digest(&archive)));
    assert!(client.captures().await.unwrap().items.is_empty(), "it is not listed yet");
    let job = NewJob { capture: begun.id.clone(), ..NewJob::default() };
    let refused = client.create_job(&job, None).await.unwrap_err();
    assert_eq!(refused.problem().unwrap().kind, "urn:relume:problem:capture-validating");
    let again = accepted(post_later(client, archive.clone()).await).await;
    assert_eq!(again.id, begun.id, "a repetition makes nothing twice");
    assert_eq!(client.delete_capture(&begun.id, false).await.unwrap_err().problem().unwrap().status, 409);
    let ready = validated(client, &begun).await;
    let photographs = ready.report.train_images + ready.report.test_images;
    assert_eq!((ready.state, photographs), (CaptureState::Ready, 4), "{:?}", ready.problem);
    assert_eq!(ready.id, begun.id);
    assert_eq!(client.captures().await.unwrap().items, std::slice::from_ref(&ready));
    // The bytes of a repetition are removed when it is detected.
    let kept = [format!("artifacts/captures/{}", ready.sha256)];
    let stored =
        || -> Vec<String> { files_under(server.data_dir()).into_iter().map(|(name, _)| name).collect() };
    for _ in 0..500 {
        if stored() == kept {
            break;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert_eq!(stored(), kept, "and nothing else is left");
    assert_eq!(post_later(client, archive).await.status(), 200, "it is there");
    let job = client.create_job(&small_job(&ready.id, 3, 5), None).await.unwrap();
    ended(client, &job.id).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn concurrent_asynchronous_uploads_make_one_capture() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let archive = slow_zip();
    let later = || async { accepted(post_later(client, archive.clone()).await).await };
    let at_once = async { client.upload_capture_bytes(archive.clone()).await.unwrap() };
    let (a, b, c, made) = tokio::join!(later(), later(), later(), at_once);
    assert!(a.id == b.id && b.id == c.id, "{a:?} {b:?} {c:?}");
    let found = validated(client, &a).await;
    match found.state {
        CaptureState::Ready => assert_eq!(found.id, made.id),
        _ => {
            let problem = found.problem.unwrap();
            assert_eq!(problem.kind, "urn:relume:problem:stored-before");
            assert!(problem.detail.unwrap().contains(made.id.as_str()));
        }
    }
    assert_eq!(client.captures().await.unwrap().items.len(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_invalid_asynchronous_capture_keeps_its_upload() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let begun = accepted(post_later(client, b"no archive".to_vec()).await).await;
    let found = validated(client, &begun).await;
    assert_eq!(found.state, CaptureState::Invalid);
    assert_eq!(found.problem.unwrap().kind, "urn:relume:problem:invalid-content");
    let job = NewJob { capture: begun.id.clone(), ..NewJob::default() };
    assert_eq!(client.create_job(&job, None).await.unwrap_err().problem().unwrap().status, 422);
    let upload = found.upload.unwrap();
    assert_eq!(client.upload(&upload).await.unwrap().offset, 10);
    client.delete_capture(&begun.id, false).await.unwrap();
    assert_eq!(client.capture(&begun.id).await.unwrap_err().problem().unwrap().status, 404);
    assert!(files_under(server.data_dir()).is_empty());

    // The same for a resumable upload.
    let archive = capture_zip();
    let id = client.begin_upload(archive.len() as u64).await.unwrap();
    client.send_piece(&id, 0, archive).await.unwrap();
    let request = client.request(Method::POST, "/v1/captures").unwrap().header("prefer", "respond-async");
    let answer = request.json(&CaptureSource::upload(id.clone())).send().await.unwrap();
    let begun = accepted(answer).await;
    assert_eq!(begun.upload.as_ref(), Some(&id));
    assert_eq!(validated(client, &begun).await.state, CaptureState::Ready);
}

#[tokio::test(flavor = "multi_thread")]
async fn kill_9_during_validation_loses_nothing() {
    let data = TempDir::new().unwrap();
    let mut server = Server::start(data.path());
    let begun = accepted(post_later(&server.client, slow_zip()).await).await;
    for _ in 0..2 {
        server.kill();
        server = Server::start(data.path());
        let found = server.client.capture(&begun.id).await.unwrap();
        assert_ne!(found.state, CaptureState::Invalid, "{:?}", found.problem);
    }
    let ready = validated(&server.client, &begun).await;
    assert_eq!((ready.state, &ready.sha256), (CaptureState::Ready, &begun.sha256));
    // The bytes of the upload are removed shortly after the capture is ready.
    let stored = || files_under(&data.path().join("artifacts"));
    for _ in 0..200 {
        if stored().len() == 1 {
            return;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    panic!("{:?}", stored());
}

fn change(body: serde_json::Value) -> MetadataChange {
    serde_json::from_value(body).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn metadata_changed_during_validation_is_kept() {
    let data = TempDir::new().unwrap();
    let mut server = Server::start(data.path());
    let archive = slow_zip();
    let query = "?name=Lion&external_id=asset-7&labels=show:alpha,take:1";
    let begun = accepted(post_called(&server.client, query, archive.clone()).await).await;
    assert_eq!((begun.metadata.name.as_deref(), begun.metadata.labels.len()), (Some("Lion"), 2));
    // During the validation; omitted fields are unchanged, even if the server is killed.
    let called = change(json!({ "name": "Lion head", "labels": { "take": null, "keep": "true" } }));
    let changed = server.client.change_capture(&begun.id, &called).await.unwrap();
    let labels = [("keep", "true"), ("show", "alpha")].map(|(k, v)| (k.to_owned(), v.to_owned()));
    let expected = ResourceMetadata {
        name: Some("Lion head".to_owned()),
        external_id: Some("asset-7".to_owned()),
        labels: labels.into(),
    };
    assert_eq!((changed.state, &changed.metadata), (CaptureState::Validating, &expected));
    server.kill();
    server = Server::start(data.path());
    let again = accepted(post_called(&server.client, "?external_id=asset-8", archive).await).await;
    let expected = ResourceMetadata { external_id: Some("asset-8".to_owned()), ..expected };
    assert_eq!((&again.id, &again.metadata), (&begun.id, &expected), "a repetition says it anew");
    let many: BTreeMap<String, &str> = (0..15).map(|n| (n.to_string(), "x")).collect();
    let refused = server.client.change_capture(&begun.id, &change(json!({ "labels": many }))).await;
    assert_eq!(refused.unwrap_err().problem().unwrap().status, 422);
    let ready = validated(&server.client, &begun).await;
    assert_eq!((ready.state, &ready.metadata), (CaptureState::Ready, &expected));
    let listed = server.client.captures().await.unwrap().items;
    assert_eq!(listed, [ready], "and so it is in the list");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_asynchronous_capture_of_an_upload_keeps_its_metadata() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let archive = capture_zip();
    let id = client.begin_upload(archive.len() as u64).await.unwrap();
    client.send_piece(&id, 0, archive).await.unwrap();
    let request = client.request(Method::POST, "/v1/captures?name=Lion").unwrap();
    let answer =
        request.header("prefer", "respond-async").json(&CaptureSource::upload(id)).send().await.unwrap();
    let begun = accepted(answer).await;
    let ready = validated(client, &begun).await;
    assert_eq!((ready.state, ready.metadata.name.as_deref()), (CaptureState::Ready, Some("Lion")));
    // An invalid capture has metadata as well, while it exists.
    let begun = accepted(post_called(client, "?name=broken", b"no archive".to_vec()).await).await;
    let found = validated(client, &begun).await;
    assert_eq!((found.state, found.metadata.name.as_deref()), (CaptureState::Invalid, Some("broken")));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_capture_that_ends_five_servers_becomes_invalid() {
    let server = testing::spawn().await.unwrap();
    let id = accepted(post_later(server.client(), CaptureZip::new(1, 32).zip()).await).await.id;
    let mut data = server.data_dir().to_owned();
    let mut server = Some(server);
    let mut codes = Vec::new();
    // The number of servers that have ended before, and the code of the problem after the next start. A server that was stopped
    // does not count.
    for ended_before in [None, Some(3), Some(4), None] {
        let running = server.take().unwrap();
        while running.client().capture(&id).await.unwrap().state == CaptureState::Validating {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        let problem = running.client().capture(&id).await.unwrap().problem.unwrap();
        codes.push(problem.content.unwrap().code);
        let kept = running.stop().await.unwrap();
        data = kept.path().to_owned();
        let pool = raw_pool(&data).await;
        let count = ended_before.map_or("interrupted_validations".to_owned(), |count: i64| count.to_string());
        let begun = format!("UPDATE uploads SET problem = NULL, interrupted_validations = {count}");
        sqlx::query(sqlx::AssertSqlSafe(begun)).execute(&pool).await.unwrap();
        pool.close().await;
        server = Some(testing::spawn_with(kept, |_| {}).await.unwrap());
    }
    let few = "capture_too_few_images";
    assert_eq!(codes, [few, few, few, "validation_interrupted"], "{}", data.display());
}
