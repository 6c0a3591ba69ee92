//! Places for further photographs over HTTP.

use std::fs;
use std::process::Command;

use relume::testing;
use relume_api::ModelId;
use relume_api::exports::ExportState;
use relume_api::next_photographs::NextPhotographsRequest;
use relume_client::Client;
use reqwest::Method;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::service_exports::{ended, queued};
use crate::service_support::trained;

/// Status and body of an answer.
async fn post(client: &Client, model: &ModelId, body: &Value) -> (u16, Value) {
    let path = format!("/v1/models/{model}/next-photographs");
    let answer = client.request(Method::POST, &path).unwrap().json(body).send().await.unwrap();
    let status = answer.status().as_u16();
    (status, serde_json::from_str(&answer.text().await.unwrap()).unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn places_are_those_of_the_command_line() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("model"), client.file(&model, "model.safetensors").await.unwrap()).unwrap();
    let local = |more: &[&str]| -> Value {
        let command = ["capture", "next", "model", "--out", "next.json"];
        let mut relume = Command::new(env!("CARGO_BIN_EXE_relume"));
        let output = relume.args([&command, more].concat()).current_dir(folder.path()).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&fs::read(folder.path().join("next.json")).unwrap()).unwrap()
    };
    let poses = |cameras: &Value| -> Vec<Value> {
        let cameras = cameras["cameras"].as_array().unwrap();
        cameras.iter().map(|camera| camera["camera"]["camera_to_world"].clone()).collect()
    };

    let ten = client.next_photographs(&model, &NextPhotographsRequest::default()).await.unwrap();
    let found = json!(ten);
    assert_eq!((ten.cameras.len(), poses(&found)), (10, poses(&local(&[]))));
    assert!(ten.cameras.iter().all(|place| (0.0..=1.0).contains(&place.lack_of_confidence)), "{ten:?}");
    assert!(ten.cameras.windows(2).any(|pair| pair[0].azimuth_deg != pair[1].azimuth_deg), "{ten:?}");

    fs::write(folder.path().join("pool.json"), found.to_string()).unwrap();
    let (status, two) = post(client, &model, &json!({ "count": 2, "path": found })).await;
    assert_eq!(status, 200, "{two}");
    assert_eq!(poses(&two), poses(&local(&["--count", "2", "--among", "pool.json"])));
    let [chosen, candidate] = [&two["cameras"][1], &two["cameras"][1]["candidate"]];
    let azimuth_of = |place: &Value| place["azimuth_deg"].as_f64().unwrap();
    let named = &found["cameras"][usize::try_from(candidate.as_u64().unwrap()).unwrap()];
    assert!((azimuth_of(chosen) - azimuth_of(named)).abs() < 1e-6, "{chosen} {named}");

    let frames = json!({ "kind": "frames", "path": two, "width": 16, "height": 16 });
    let export = queued(client, &model, &frames).await;
    assert_eq!(ended(client, &export.id).await.state, ExportState::Succeeded, "the places are a path");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_invalid_request_for_places_is_refused() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    for (body, pointer) in [
        (json!({ "count": 0 }), "/count"),
        (json!({ "count": 1001 }), "/count"),
        (json!({ "path": { "cameras": [] } }), "/path"),
        (json!({ "path": { "cameras": [{ "camera": {} }] } }), "/path/cameras/0/camera"),
        (
            json!({ "path_world": { "scale": 1, "transform": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]] } }),
            "/path_world",
        ),
        (json!({ "places": 3 }), "/places"),
    ] {
        let (status, problem) = post(client, &model, &body).await;
        assert_eq!((status, &problem["errors"][0]["pointer"]), (422, &json!(pointer)), "{problem}");
    }
    let (status, _) = post(client, &"nothing".into(), &json!({})).await;
    assert_eq!(status, 404);
}
