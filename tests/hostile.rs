//! Invalid input over HTTP: each request gets its 4xx problem, the server keeps running, and no files remain.

use std::time::Duration;

use relume::testing::{self, TestServer};
use relume_capture::formats::exr_image;
use relume_client::Client;
use reqwest::{Method, header};
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};

use crate::service_support::{CaptureZip, capture_zip, files_under, zip_of};

/// The expected problem for an invalid body.
struct Refusal {
    status: u16,
    body: Value,
}

async fn post(client: &Client, path: &str, media: &str, bytes: Vec<u8>) -> Refusal {
    let request = client.request(Method::POST, path).unwrap().header(header::CONTENT_TYPE, media);
    let response = request.body(bytes).send().await.unwrap();
    let media = response.headers()[header::CONTENT_TYPE].to_str().unwrap().to_owned();
    let status = response.status().as_u16();
    let text = response.text().await.unwrap();
    assert_eq!(media, "application/problem+json", "{status} {text}");
    Refusal { status, body: serde_json::from_str(&text).unwrap() }
}

/// Sends an invalid archive to the routes that store and validate captures, and checks the answers and the
/// remaining files.
async fn refuse_capture(server: &TestServer, zip: Vec<u8>, code: &str, named: &str) {
    for path in ["/v1/captures", "/v1/captures/validate"] {
        let refusal = post(server.client(), path, "application/zip", zip.clone()).await;
        let body = &refusal.body;
        assert_eq!(refusal.status, 422, "{body}");
        assert_eq!(body["content"]["code"], code, "{body}");
        let detail = body["detail"].as_str().unwrap();
        assert!(detail.contains(named), "{detail:?} does not name {named:?}");
        let root = server.data_dir().display().to_string();
        assert!(!detail.contains(&root), "{detail:?} tells of the server's disk");
    }
    assert!(files_under(server.data_dir()).is_empty(), "{:?}", files_under(server.data_dir()));
}

/// The server runs and still accepts valid input.
async fn lives(server: &TestServer) {
    let health = server.client().request(Method::GET, "/readyz").unwrap().send().await.unwrap();
    assert!(health.status().is_success());
    server.client().upload_capture_bytes(capture_zip()).await.unwrap();
}

/// A capture with one fault.
fn spoiled(change: impl FnOnce(&mut CaptureZip)) -> Vec<u8> {
    let mut capture = CaptureZip::new(8, 32);
    change(&mut capture);
    capture.zip()
}

/// Changes the text of `transforms_train.json`, for faults that JSON values cannot express.
fn spoiled_text(from: &str, to: &str) -> Vec<u8> {
    let capture = CaptureZip::new(8, 32);
    let text = capture.transforms.to_string();
    assert!(text.contains(from));
    let mut entries = vec![("transforms_train.json".to_owned(), text.replacen(from, to, 1).into_bytes())];
    entries.extend(capture.images);
    zip_of(&entries)
}

/// The first bytes of a PNG that claims to be `side` pixels wide and high.
fn png_header(side: u32) -> Vec<u8> {
    let mut chunk = b"IHDR".to_vec();
    chunk.extend([side.to_be_bytes(), side.to_be_bytes()].concat());
    chunk.extend([8, 6, 0, 0, 0]);
    let mut crc = flate2::Crc::new();
    crc.update(&chunk);
    let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\x0d".to_vec();
    png.extend(&chunk);
    png.extend(crc.sum().to_be_bytes());
    png
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_archives_are_refused_with_a_code_and_leave_nothing() {
    let server = testing::spawn().await.unwrap();
    let zip = capture_zip();
    let damaged = "capture_archive_damaged";
    refuse_capture(&server, zip[..zip.len() / 2].to_vec(), damaged, "").await;
    refuse_capture(&server, b"this is no archive at all".to_vec(), damaged, "").await;
    refuse_capture(&server, Vec::new(), damaged, "").await;
    let bomb = spoiled(|c| c.images.push(("bomb.bin".into(), vec![0; 64 << 20])));
    assert!(bomb.len() < 1 << 20, "it is small on the wire");
    refuse_capture(&server, bomb, "capture_over_limit", "bomb.bin").await;
    let escape = spoiled(|c| c.images.push(("../../escape.txt".into(), b"out".to_vec())));
    refuse_capture(&server, escape, "capture_archive_unsafe", "escape.txt").await;
    refuse_capture(&server, zip_of(&[("notes.txt".into(), b"hi".to_vec())]), "capture_layout_unknown", "")
        .await;
    lives(&server).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_images_are_refused_with_the_file_and_leave_nothing() {
    let server = testing::spawn().await.unwrap();
    let image = |bytes: Vec<u8>| spoiled(|c| c.images[3].1 = bytes);
    let named = "r_3.png";
    refuse_capture(&server, image(b"just some text".to_vec()), "capture_image_invalid", named).await;
    refuse_capture(&server, image(Vec::new()), "capture_image_invalid", named).await;
    refuse_capture(&server, image(png_header(20_000)), "capture_over_limit", named).await;
    refuse_capture(&server, CaptureZip::new(1, 32).zip(), "capture_too_few_images", "1").await;
    lives(&server).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_cameras_are_refused_with_the_field_and_leave_nothing() {
    let server = testing::spawn().await.unwrap();
    let singular = spoiled(|c| c.transforms["frames"][2]["transform_matrix"] = json!(vec![[0.0; 4]; 4]));
    refuse_capture(&server, singular, "capture_field_invalid", "transform_matrix").await;
    let infinite = spoiled(|c| c.transforms["frames"][2]["transform_matrix"][0][0] = json!("x"));
    refuse_capture(&server, infinite, "capture_field_invalid", "transform_matrix").await;
    let blind = spoiled(|c| {
        c.transforms.as_object_mut().unwrap().remove("camera_angle_x");
    });
    refuse_capture(&server, blind, "capture_field_invalid", "camera_angle_x").await;
    let first = CaptureZip::new(8, 32).transforms["frames"][0]["transform_matrix"][0][0].to_string();
    let nan = spoiled_text(&format!("[[{first}"), "[[NaN");
    refuse_capture(&server, nan, "capture_field_invalid", "transform_matrix").await;
    lives(&server).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_environments_are_refused_and_leave_nothing() {
    let server = testing::spawn().await.unwrap();
    let mut texels = vec![[1.0f32; 3]; 8];
    texels[5][1] = f32::NAN;
    let nan = exr_image::encode_rgb(4, 2, &texels).unwrap();
    for (bytes, named) in [(nan, "row 1"), (b"#?RADIANCE\n".to_vec(), ""), (b"text".to_vec(), "")] {
        let refusal = post(server.client(), "/v1/environments", "image/x-exr", bytes).await;
        assert_eq!(refusal.status, 422, "{}", refusal.body);
        assert_eq!(refusal.body["content"]["code"], "environment_invalid");
        assert!(refusal.body["detail"].as_str().unwrap().contains(named), "{}", refusal.body);
    }
    assert!(files_under(server.data_dir()).is_empty());
    lives(&server).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn forms_with_wrong_fields_are_refused_and_leave_nothing() {
    let server = testing::spawn().await.unwrap();
    let form = |fields: &[&'static str]| {
        fields.iter().fold(reqwest::multipart::Form::new(), |form, name| {
            form.part(*name, reqwest::multipart::Part::bytes(capture_zip()))
        })
    };
    for (fields, pointer) in [(&["photo"][..], "/photo"), (&["archive", "archive"], "/archive")] {
        let request = server.client().request(Method::POST, "/v1/captures").unwrap();
        let response = request.multipart(form(fields)).send().await.unwrap();
        assert_eq!(response.status(), 422);
        let body: Value = serde_json::from_str(&response.text().await.unwrap()).unwrap();
        assert_eq!(body["errors"][0]["pointer"], pointer, "{body}");
    }
    assert!(files_under(server.data_dir()).is_empty());
    let form = "multipart/form-data; boundary=x";
    let empty = post(server.client(), "/v1/captures", form, b"--x--\r\n".to_vec()).await;
    assert_eq!(empty.body["errors"][0]["pointer"], "/archive", "{}", empty.body);
    let cut = post(server.client(), "/v1/captures", form, b"--x\r\nContent-Disp".to_vec()).await;
    assert_eq!((cut.status, &cut.body["type"]), (400, &json!("urn:relume:problem:malformed-form")));
    assert!(files_under(server.data_dir()).is_empty());
    let media = post(server.client(), "/v1/captures", "text/plain", b"hello".to_vec()).await;
    assert_eq!(media.status, 415);
    lives(&server).await;
}

/// Sends `head` and `body` over a TCP connection and reads the first line of the answer.
async fn raw(server: &TestServer, head: &str, body: &[u8]) -> String {
    let base = server.client().base();
    let address = format!("{}:{}", base.host_str().unwrap(), base.port().unwrap());
    let mut stream = tokio::net::TcpStream::connect(address).await.unwrap();
    stream.write_all(head.as_bytes()).await.unwrap();
    // The server may close the connection before it has read everything; only its answer counts.
    stream.write_all(body).await.ok();
    let mut answer = vec![0; 64];
    let read = tokio::time::timeout(Duration::from_secs(20), stream.read(&mut answer));
    let count = read.await.expect("an answer in time").unwrap_or(0);
    String::from_utf8_lossy(&answer[..count]).lines().next().unwrap_or_default().to_owned()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_body_of_two_gigabytes_is_refused_before_it_is_sent() {
    let limits = |c: &mut relume::server::ServerConfig| c.limits.capture_bytes = 1 << 20;
    let server = testing::spawn_with(tempfile::tempdir().unwrap(), limits).await.unwrap();
    for (path, media) in [
        ("/v1/captures", "application/zip"),
        ("/v1/captures/validate", "multipart/form-data; boundary=x"),
        ("/v1/environments", "image/x-exr"),
        ("/v1/jobs", "application/json"),
    ] {
        let head = format!(
            "POST {path} HTTP/1.1\r\nHost: localhost\r\nContent-Type: {media}\r\nContent-Length: 2147483648\r\n\r\n"
        );
        assert_eq!(raw(&server, &head, b"").await, "HTTP/1.1 413 Payload Too Large", "{path}");
    }
    assert!(files_under(server.data_dir()).is_empty());
    lives(&server).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_chunked_body_over_the_limit_answers_413() {
    let limits = |c: &mut relume::server::ServerConfig| c.limits.capture_bytes = 1 << 20;
    let server = testing::spawn_with(tempfile::tempdir().unwrap(), limits).await.unwrap();
    let head = "POST /v1/captures HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/zip\r\n\
                Transfer-Encoding: chunked\r\n\r\n";
    let chunk =
        [format!("{:x}\r\n", (1 << 20) + 1).into_bytes(), vec![7; (1 << 20) + 1], b"\r\n".to_vec()].concat();
    assert_eq!(raw(&server, head, &chunk).await, "HTTP/1.1 413 Payload Too Large");
    assert!(files_under(server.data_dir()).is_empty());
    lives(&server).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_interrupted_upload_leaves_nothing_behind() {
    let server = testing::spawn().await.unwrap();
    lives(&server).await;
    let before = files_under(server.data_dir());
    let head = "POST /v1/captures HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/zip\r\nContent-Length: 99999999\r\n\r\n";
    let base = server.client().base();
    let address = format!("{}:{}", base.host_str().unwrap(), base.port().unwrap());
    let mut stream = tokio::net::TcpStream::connect(address).await.unwrap();
    stream.write_all(head.as_bytes()).await.unwrap();
    stream.write_all(&vec![0; 6 << 20]).await.unwrap();
    while files_under(server.data_dir()) == before {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    drop(stream);
    for _ in 0..500 {
        if files_under(server.data_dir()) == before {
            return;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    panic!("left behind: {:?}", files_under(server.data_dir()));
}
