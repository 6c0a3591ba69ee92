//! Answers about uploads: metadata of captures, queries, lists.

use std::sync::Arc;
use std::time::Duration;

use relume::jobs::ManualClock;
use relume::server::ServerConfig;
use relume::testing;
use relume_api::UploadId;
use relume_api::uploads::UploadState;
use relume_client::Client;
use reqwest::Method;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::service_support::capture_zip;
use crate::service_uploads::{artifacts, offset, refusal, send, tus};

/// Makes a capture of an upload, with the metadata in the query.
async fn capture_called(client: &Client, id: &UploadId, query: &str) -> (u16, Value) {
    let request = client.request(Method::POST, &format!("/v1/captures?{query}")).unwrap();
    let answer = send(request.json(&json!({ "upload": id }))).await;
    (answer.status().as_u16(), serde_json::from_str(&answer.text().await.unwrap()).unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn an_upload_is_kept_when_its_metadata_is_refused() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let archive = capture_zip();
    let begin = async || {
        let id = client.begin_upload(archive.len() as u64).await.unwrap();
        client.send_piece(&id, 0, archive.clone()).await.unwrap();
        id
    };
    let first: Vec<String> = (0..16).map(|n| format!("k{n}:v")).collect();
    let (status, made) = capture_called(client, &begin().await, &format!("labels={}", first.join(","))).await;
    assert_eq!((status, made["labels"].as_object().unwrap().len()), (201, 16), "{made}");
    // The same content again, with one label more than permitted.
    let again = begin().await;
    let (status, refused) = capture_called(client, &again, "labels=another:v").await;
    assert_eq!((status, &refused["errors"][0]["pointer"]), (422, &json!("query/labels")), "{refused}");
    assert_eq!(offset(client, &again).await, archive.len() as u64, "it was not taken");
    let (status, called) = capture_called(client, &again, "labels=k3:w&name=Lion").await;
    assert_eq!(status, 200, "{called}");
    assert_eq!(
        (&called["id"], &called["name"], &called["labels"]["k3"]),
        (&made["id"], &json!("Lion"), &json!("w"))
    );
    assert_eq!(refusal(client.upload(&again).await).0, 404);
}

#[tokio::test(flavor = "multi_thread")]
async fn unsupported_upload_query_parameters_are_refused() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    for (query, pointer) in
        [("name=Lion", "query/name"), ("labels=a:1&x=2", "query/labels"), ("x", "query/x")]
    {
        let request = tus(client, Method::POST, &format!("/v1/uploads?{query}")).header("upload-length", 9);
        let answer = send(request).await;
        let (status, text) = (answer.status().as_u16(), answer.text().await.unwrap());
        let refused: Value = serde_json::from_str(&text).unwrap();
        assert_eq!((status, &refused["errors"][0]["pointer"]), (422, &json!(pointer)), "{refused}");
    }
    let validate = client.request(Method::POST, "/v1/captures/validate?labels=a:1").unwrap().body("PK");
    let answer = send(validate.header("content-type", "application/zip")).await;
    assert_eq!(answer.status(), 422);
    assert!(answer.text().await.unwrap().contains("query/labels"), "what is only tried is called nothing");
    assert!(artifacts(&server).is_empty(), "nothing was begun");
    assert_eq!(
        send(tus(client, Method::POST, "/v1/uploads?").header("upload-length", 9)).await.status(),
        201
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn uploads_are_listed_until_used_deleted_or_expired() {
    let clock = Arc::new(ManualClock::default());
    let hands = clock.clone();
    let change = move |config: &mut ServerConfig| config.clock = hands;
    let server = testing::spawn_with(TempDir::new().unwrap(), change).await.unwrap();
    let client = server.client();
    let mut begun = Vec::new();
    for length in [9, 10, 11, 12] {
        begun.push(client.begin_upload(length).await.unwrap());
        clock.advance(Duration::from_secs(1));
    }
    client.send_piece(&begun[1], 0, "no capture").await.unwrap();
    client.send_piece(&begun[2], 0, "no capture!").await.unwrap();
    let request = client.request(Method::POST, "/v1/captures").unwrap().header("prefer", "respond-async");
    let promised = send(request.json(&json!({ "upload": begun[2] }))).await;
    assert_eq!(promised.status(), 202);
    let promised: Value = serde_json::from_str(&promised.text().await.unwrap()).unwrap();
    while client.upload(&begun[2]).await.unwrap().state == UploadState::Validating {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    let listed = client.uploads().await.unwrap();
    assert_eq!(listed.next, None);
    let told: Vec<_> = listed.items.iter().map(|u| (u.id.clone(), u.state, u.offset, u.length)).collect();
    let expected = [
        (begun[3].clone(), UploadState::Receiving, 0, 12),
        (begun[2].clone(), UploadState::Invalid, 11, 11),
        (begun[1].clone(), UploadState::Complete, 10, 10),
        (begun[0].clone(), UploadState::Receiving, 0, 9),
    ];
    assert_eq!(told, expected);
    assert_eq!(listed.items[1].capture.as_ref().map(|id| json!(id)), Some(promised["id"].clone()));
    for upload in &listed.items {
        assert_eq!(&client.upload(&upload.id).await.unwrap(), upload, "as it is by itself");
    }

    let page = async |query: &str| -> Value {
        let answer = send(client.request(Method::GET, &format!("/v1/uploads?{query}")).unwrap()).await;
        serde_json::from_str(&answer.text().await.unwrap()).unwrap()
    };
    let ids = |page: &Value| -> Vec<Value> {
        page["items"].as_array().unwrap().iter().map(|item| item["id"].clone()).collect()
    };
    let first = page("limit=3").await;
    assert_eq!(ids(&first).len(), 3);
    for before in [first["next"].as_str().unwrap(), begun[1].as_str()] {
        let rest = page(&format!("limit=3&before={before}")).await;
        assert_eq!((ids(&rest), &rest["next"]), (vec![json!(begun[0])], &json!(null)));
    }
    for (query, pointer) in
        [("limit=0", "query/limit"), ("before=x", "query/before"), ("state=complete", "query/state")]
    {
        let refused = page(query).await;
        assert_eq!(refused["errors"][0]["pointer"], pointer, "{refused}");
    }

    client.delete_upload(&begun[3]).await.unwrap();
    assert_eq!(client.uploads().await.unwrap().items.len(), 3);
    clock.advance(Duration::from_secs(48 * 3600));
    assert_eq!(client.uploads().await.unwrap().items, []);
}
