//! NUL characters, which PostgreSQL cannot store: both databases answer with the field.

use relume::testing;
use relume_api::captures::CaptureState;
use relume_client::Client;
use reqwest::{Method, header};
use serde_json::{Value, json};

use crate::service_support::CaptureZip;

/// Status and first field of an answer.
async fn answer(request: reqwest::RequestBuilder) -> (u16, Value) {
    let answer = request.send().await.unwrap();
    let status = answer.status().as_u16();
    let problem: Value = answer.json().await.unwrap_or_default();
    (status, problem["errors"][0]["pointer"].clone())
}

fn request(client: &Client, method: Method, path: &str) -> reqwest::RequestBuilder {
    client.request(method, path).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_nul_in_a_request_answers_400_with_the_field() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    for path in ["jobs", "captures", "models", "environments", "exports", "uploads", "webhooks", "keys"] {
        let (status, field) = answer(request(client, Method::GET, &format!("/v1/{path}/a%00b"))).await;
        assert_eq!((status, &field), (400, &json!("path")), "{path}");
        let (status, _) = answer(request(client, Method::GET, &format!("/v1/{path}/%ED%A0%80"))).await;
        assert_eq!(status, 400, "{path}");
    }
    for (query, field) in [("label=a:%00", "query/label"), ("external_id=%00", "query/external_id")] {
        let told = answer(request(client, Method::GET, &format!("/v1/jobs?{query}"))).await;
        assert_eq!(told, (400, json!(field)));
    }
    for (body, field) in [
        (json!({"capture": "a\0b"}), "/capture"),
        (json!({"capture": "ab", "labels": {"a": "b\0"}}), "/labels/a"),
    ] {
        let told = answer(request(client, Method::POST, "/v1/jobs").json(&body)).await;
        assert_eq!(told, (400, json!(field)));
    }
    let told = answer(request(client, Method::POST, "/v1/jobs").json(&json!({"capture": "ab"}))).await;
    assert_eq!(told, (422, json!("/capture")), "the control: a capture that does not exist");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_nul_in_a_pose_file_makes_the_capture_invalid() {
    let server = testing::spawn().await.unwrap();
    let mut capture = CaptureZip::new(8, 32);
    capture.transforms["frames"][2]["file_path"] = json!("train/\0");
    let upload = request(server.client(), Method::POST, "/v1/captures").header("prefer", "respond-async");
    let upload = upload.header(header::CONTENT_TYPE, "application/zip").body(capture.zip());
    let made: Value = upload.send().await.unwrap().json().await.unwrap();
    let path = format!("/v1/captures/{}", made["id"].as_str().unwrap());
    let ended = loop {
        let now: Value =
            request(server.client(), Method::GET, &path).send().await.unwrap().json().await.unwrap();
        if now["state"] != json!(CaptureState::Validating) {
            break now;
        }
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    };
    assert_eq!(ended["state"], json!(CaptureState::Invalid), "{ended}");
    assert_eq!(ended["problem"]["content"]["field"], "frames[2].file_path", "{ended}");
}
