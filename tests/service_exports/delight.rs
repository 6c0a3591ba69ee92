//! Exports of photographs without their light.

use std::fs;
use std::path::Path;

use relume::testing;
use relume_api::cameras::CameraConvention;
use relume_api::exports::{DelightExport, NewExport};
use relume_spec::rendering::LayerFormat;
use serde_json::{Value, json};

use crate::service_support::capture_zip;

use super::{entries, made, post, relume, trained, with_model};

/// The files of `relume delight`, by their path in `folder`.
fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(at) = folders.pop() {
        for entry in fs::read_dir(at).unwrap().map(|entry| entry.unwrap().path()) {
            match entry.is_dir() {
                true => folders.push(entry),
                false => found.push((
                    entry.strip_prefix(folder).unwrap().display().to_string(),
                    fs::read(&entry).unwrap(),
                )),
            }
        }
    }
    found.sort();
    found
}

fn sorted(bytes: &[u8]) -> Vec<(String, Vec<u8>)> {
    let mut found = entries(bytes);
    found.sort();
    found
}

#[tokio::test(flavor = "multi_thread")]
async fn exported_layers_equal_those_of_the_command_line() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let job = trained(client).await;
    let model = job.model.unwrap();
    let folder = with_model(client, &model).await;
    let at = folder.path();
    fs::write(at.join("capture.zip"), capture_zip()).unwrap();
    let local = |out: &str, more: &[&str]| {
        let command = ["delight", "capture.zip", model.as_str(), "--device", "cpu", "--out", out];
        relume(at, &[&command, more].concat());
        files(&at.join(out))
    };

    let (export, bytes) = made(client, &model, &json!(NewExport::Delight(DelightExport::default()))).await;
    let all = local("all", &[]);
    assert!(all.len() > 2 && sorted(&bytes) == all, "{} photographs", all.len());
    assert_eq!((export.progress.done, export.progress.total), (all.len() as i64, all.len() as i64));
    let file = export.file.unwrap();
    assert_eq!((file.name, file.content_type), (format!("{model}-layers.zip"), "application/zip".into()));

    let capture = client.capture_photographs(&job.capture, CameraConvention::Opengl).await.unwrap();
    let wanted = &capture.photographs.last().unwrap().taken.name;
    let spec = DelightExport {
        photographs: Some(vec![wanted.clone(), wanted.clone()]),
        resolution: Some(16),
        format: LayerFormat::Png,
        ..DelightExport::default()
    };
    let (export, bytes) = made(client, &model, &json!(NewExport::Delight(spec))).await;
    assert_eq!(export.progress.total, 1, "a repeated name is one photograph");
    let one = local("one", &["--format", "png", "--resolution", "16", "--name", wanted]);
    assert_eq!(one.len(), 5, "a file for each layer");
    assert!(sorted(&bytes) == one);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_invalid_export_of_layers_is_refused() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let job = trained(client).await;
    let model = job.model.unwrap();
    for (body, pointer) in [
        (json!({ "kind": "delight", "resolution": 8 }), "/resolution"),
        (json!({ "kind": "delight", "photographs": [] }), "/photographs"),
        (json!({ "kind": "delight", "photographs": ["nowhere.png"] }), "/photographs/0"),
        (json!({ "kind": "delight", "format": "jpeg" }), "/format"),
        (json!({ "kind": "delight", "materials": [] }), "/materials"),
    ] {
        let refused = post(client, &model, &body).await;
        let status = refused.status().as_u16();
        let problem: Value = serde_json::from_str(&refused.text().await.unwrap()).unwrap();
        assert_eq!((status, &problem["errors"][0]["pointer"]), (422, &json!(pointer)), "{problem}");
    }
    client.delete_capture(&job.capture, true).await.unwrap();
    let refused = post(client, &model, &json!({ "kind": "delight" })).await;
    let status = refused.status().as_u16();
    let problem: Value = serde_json::from_str(&refused.text().await.unwrap()).unwrap();
    assert_eq!((status, &problem["type"]), (409, &json!("urn:relume:problem:capture-deleted")), "{problem}");
    assert!(client.exports(None).await.unwrap().items.is_empty(), "nothing was queued");
}
