//! Captures that are uploaded file by file.

use relume::testing::{self, TestServer};
use reqwest::multipart::{Form, Part};
use reqwest::{Method, StatusCode};
use serde_json::Value;

use crate::service_support::{CaptureZip, capture_zip, files_under};

/// The files in the archive of [`capture_zip`], by their paths.
fn files() -> Vec<(String, Vec<u8>)> {
    let capture = CaptureZip::new(8, 32);
    let transforms = serde_json::to_vec(&capture.transforms).unwrap();
    [vec![("transforms_train.json".to_owned(), transforms)], capture.images].concat()
}

fn form(files: Vec<(String, Vec<u8>)>) -> Form {
    let add = |form: Form, (name, bytes)| form.part("files", Part::bytes(bytes).file_name(name));
    files.into_iter().fold(Form::new(), add)
}

async fn send(server: &TestServer, path: &str, form: Form) -> (StatusCode, Value) {
    let request = server.client().request(Method::POST, path).unwrap();
    let answer = request.multipart(form).send().await.unwrap();
    (answer.status(), serde_json::from_str(&answer.text().await.unwrap()).unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_capture_of_single_files_equals_that_of_their_archive() {
    let server = testing::spawn().await.unwrap();
    let archived = server.client().upload_capture_bytes(capture_zip()).await.unwrap();
    let (status, made) = send(&server, "/v1/captures", form(files())).await;
    assert_eq!(status, StatusCode::CREATED, "{made}");
    assert_ne!(made["id"], archived.id.to_string(), "the control: it is not the archive itself");
    assert_eq!(made["report"], serde_json::to_value(&archived.report).unwrap());
    let (status, again) = send(&server, "/v1/captures", form(files())).await;
    assert_eq!((status, &again["id"]), (StatusCode::OK, &made["id"]), "the same files, the same capture");
    let (status, report) = send(&server, "/v1/captures/validate", form(files())).await;
    assert_eq!((status, &report), (StatusCode::OK, &made["report"]));
    let mut large = files();
    // A path longer than the field of a tar header, and a file larger than a chunk.
    large.push((format!("{}/notes.txt", "long".repeat(40)), vec![7; 300_001]));
    let (status, made) = send(&server, "/v1/captures", form(large)).await;
    assert_eq!(status, StatusCode::CREATED, "{made}");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn an_invalid_file_form_is_refused_with_a_pointer() {
    let server = testing::spawn().await.unwrap();
    let before = files_under(server.data_dir());
    let nameless = form(files()).part("files", Part::bytes(vec![1; 10]));
    let other = form(files()).text("photos", "1.png");
    let outside = form(vec![("../../etc/passwd".to_owned(), vec![1; 10])]);
    let archive = form(files()).part("archive", Part::bytes(capture_zip()).file_name("scan.zip"));
    for (wrong, pointer) in
        [(nameless, "/files"), (other, "/photos"), (outside, "/files"), (archive, "/archive")]
    {
        let (status, problem) = send(&server, "/v1/captures", wrong).await;
        assert_eq!(status, StatusCode::UNPROCESSABLE_ENTITY, "{problem}");
        assert_eq!(problem["errors"][0]["pointer"], pointer, "{problem}");
    }
    let incomplete = files().into_iter().take(1).collect();
    let (status, problem) = send(&server, "/v1/captures", form(incomplete)).await;
    assert_eq!(status, StatusCode::UNPROCESSABLE_ENTITY, "{problem}");
    let map = form(files());
    assert_eq!(send(&server, "/v1/environments", map).await.0, StatusCode::UNPROCESSABLE_ENTITY);
    assert_eq!(files_under(server.data_dir()), before);
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn photographs_over_the_pixel_limit_are_refused_by_file_name() {
    let small = |config: &mut relume::server::ServerConfig| {
        config.worker.import_limits.max_image_pixels = 16;
    };
    let server = testing::spawn_with(tempfile::TempDir::new().unwrap(), small).await.unwrap();
    let (status, problem) = send(&server, "/v1/captures", form(files())).await;
    assert_eq!(status, StatusCode::UNPROCESSABLE_ENTITY);
    assert_eq!(problem["content"]["field"], "max_image_pixels", "{problem}");
    assert!(problem["content"]["file"].as_str().unwrap().ends_with(".png"), "{problem}");
    server.stop().await.unwrap();
}
