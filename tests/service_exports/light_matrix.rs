//! Exports of light matrices.

use std::fs;
use std::path::Path;
use std::time::Duration;

use relume::testing;
use relume_api::exports::{ExportState, LightMatrixExport, NewExport};
use serde_json::{Value, json};

use crate::light_matrix::{parts, sunny};

use super::{ended, entries, made, post, queued, relume, trained, until_gone, with_model};

fn look(x: f64) -> Value {
    json!({ "look_at": { "eye": [x, 1, 1], "target": [0, 0, 0], "fov_y_deg": 40 } })
}

/// A camera path of `count` cameras.
fn path(count: usize, size: (u32, u32)) -> Value {
    let cameras: Vec<Value> = (0..count).map(|k| json!({ "camera": look(3.0 + 0.1 * k as f64) })).collect();
    json!({ "width": size.0, "height": size.1, "cameras": cameras })
}

#[tokio::test(flavor = "multi_thread")]
async fn exported_matrices_equal_those_of_the_command_line() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let folder = with_model(client, &model).await;
    let at = folder.path();
    fs::write(at.join("one.json"), path(1, (32, 16)).to_string()).unwrap();
    fs::write(at.join("two.json"), path(2, (24, 24)).to_string()).unwrap();
    let local = |more: &[&str]| relume(at, &[&["render", model.as_str(), "--light-matrix"], more].concat());

    let of_camera = LightMatrixExport::of(serde_json::from_value(look(3.0)).unwrap());
    let of_camera = LightMatrixExport { width: Some(32), height: Some(16), lobes: 6, ..of_camera };
    let (export, bytes) =
        made(client, &model, &json!(NewExport::LightMatrix(Box::new(of_camera.clone())))).await;
    assert_eq!(export.request, Some(NewExport::LightMatrix(Box::new(of_camera))));
    let file = export.file.unwrap();
    assert_eq!((file.content_type.as_str(), export.progress.total), ("image/x-exr", 1));
    assert_eq!(file.name, format!("{model}-light-matrix.exr"));
    local(&["6", "--path", "one.json", "--out", "a/%d.exr"]);
    assert!(fs::read(at.join("a/1.exr")).unwrap() == bytes);

    fs::write(at.join("sun.hdr"), sunny()).unwrap();
    let map = client.upload_environment(sunny()).await.unwrap();
    let light = json!({ "id": map.id, "rotation_deg": 5 });
    let body = json!({ "kind": "light_matrix", "path": path(2, (24, 24)), "lobes": 4, "environment": light,
        "colour_depth": "float" });
    let (export, bytes) = made(client, &model, &body).await;
    assert_eq!((export.progress.done, export.progress.total), (2, 2));
    assert_eq!(export.file.unwrap().content_type, "application/zip");
    local(&[
        "4",
        "--path",
        "two.json",
        "--env",
        "sun.hdr",
        "--rotation",
        "5",
        "--colour-depth",
        "float",
        "--out",
        "b/%04d.exr",
    ]);
    let found = entries(&bytes);
    let names: Vec<&str> = found.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["0001.exr", "0002.exr"]);
    for (name, bytes) in &found {
        let (local, of_server) = (parts(&fs::read(at.join("b").join(name)).unwrap()), parts(bytes));
        assert_eq!((local.len(), local[4].0.starts_with("sun001_")), (5, true));
        assert!(local == of_server, "{name}: equal but for the name of the light");
    }
    assert!(found[0].1 != found[1].1, "the control");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_invalid_light_matrix_is_refused_with_a_pointer() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let matrix = |more: Value| {
        let mut body = json!({ "kind": "light_matrix", "camera": look(3.0), "width": 8, "height": 8 });
        body.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        body
    };
    let turned =
        json!({ "width": 8, "height": 8, "cameras": [{ "camera": look(3.0), "light_rotation_deg": 90 }] });
    let along = |path: Value, more: Value| {
        let mut body = json!({ "kind": "light_matrix", "path": path });
        body.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        body
    };
    for (body, pointer) in [
        (json!({ "kind": "light_matrix" }), "/camera"),
        (matrix(json!({ "path": path(1, (8, 8)) })), "/path"),
        (matrix(json!({ "camera": {} })), "/camera"),
        (matrix(json!({ "lobes": 0 })), "/lobes"),
        (matrix(json!({ "lobes": 513 })), "/lobes"),
        (matrix(json!({ "width": 4096, "height": 4096, "lobes": 17 })), "/lobes"),
        (along(path(300, (4096, 4096)), json!({ "lobes": 1 })), "/lobes"),
        (matrix(json!({ "width": 5000 })), "/width"),
        (matrix(json!({ "height": null })), "/height"),
        (matrix(json!({ "tier": "high" })), "/tier"),
        (matrix(json!({ "colour_depth": "double" })), "/colour_depth"),
        (matrix(json!({ "environment": { "exposure_ev": 1 } })), "/environment/exposure_ev"),
        (matrix(json!({ "environment": { "builtin": "moon" } })), "/environment/builtin"),
        (matrix(json!({ "environment": { "inline_base64": "AA==" } })), "/environment/inline_base64"),
        (along(json!({ "cameras": [] }), json!({})), "/path"),
        (along(turned.clone(), json!({ "environment": { "builtin": "studio" } })), "/path"),
    ] {
        let refused = post(client, &model, &body).await;
        let status = refused.status().as_u16();
        let problem: Value = serde_json::from_str(&refused.text().await.unwrap()).unwrap();
        assert_eq!((status, &problem["errors"][0]["pointer"]), (422, &json!(pointer)), "{problem}");
    }
    assert!(client.exports(None).await.unwrap().items.is_empty(), "nothing was queued");
    made(client, &model, &matrix(json!({ "lobes": 1 }))).await;
    made(client, &model, &along(turned, json!({ "lobes": 1 }))).await;
}

/// Waits until the work folder has `count` files whose name ends so.
async fn until_there(work: &Path, ending: &str, count: usize) -> Vec<std::path::PathBuf> {
    for _ in 0..3000 {
        let files = fs::read_dir(work).map(|entries| entries.map(|entry| entry.unwrap().path()));
        let files = files.map(|files| files.filter(|file| file.extension().is_some_and(|e| e == ending)));
        let found: Vec<_> = files.into_iter().flatten().collect();
        if found.len() >= count {
            return found;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    panic!("{} never has {count} files .{ending}", work.display());
}

#[tokio::test(flavor = "multi_thread")]
async fn matrices_of_a_path_resume_after_a_restart() {
    let server = testing::spawn().await.unwrap();
    let model = trained(server.client()).await.model.unwrap();
    let body = json!({ "kind": "light_matrix", "path": path(40, (128, 128)), "lobes": 64 });
    let export = queued(server.client(), &model, &body).await;
    let work = server.data_dir().join("exports").join(export.id.as_str());
    until_there(&work, "exr", 2).await;
    let data = server.stop().await.unwrap();
    let work = data.path().join("exports").join(export.id.as_str());
    let there = until_there(&work, "exr", 2).await;
    assert!(there.len() < 40, "it was stopped in between: {}", there.len());
    for file in &there {
        fs::write(file, "made earlier").unwrap();
    }
    let server = testing::spawn_with(data, |_| {}).await.unwrap();
    let export = ended(server.client(), &export.id).await;
    assert_eq!(export.state, ExportState::Succeeded, "{:?}", export.error);
    let found = entries(&server.client().export_file(&export.id).await.unwrap());
    let (earlier, later): (Vec<_>, Vec<_>) = found.iter().partition(|(_, bytes)| bytes == b"made earlier");
    assert_eq!((earlier.len(), later.len()), (there.len(), 40 - there.len()));
    let is_exr = |(_, bytes): &&(String, Vec<u8>)| bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]);
    assert!(later.iter().all(is_exr), "the control: the others are EXR files");
    until_gone(&work).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cancelled_light_matrix_stops_and_leaves_nothing() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let body =
        json!({ "kind": "light_matrix", "camera": look(3.0), "width": 700, "height": 700, "lobes": 512 });
    let export = queued(client, &model, &body).await;
    let work = server.data_dir().join("exports").join(export.id.as_str());
    until_there(&work, "part", 1).await;
    assert_eq!(client.export(&export.id).await.unwrap().state, ExportState::Running);
    client.delete_export(&export.id).await.unwrap();
    assert_eq!(client.export(&export.id).await.unwrap().state, ExportState::Cancelled);
    until_gone(&work).await;
    let (_, bytes) = made(
        client,
        &model,
        &json!({ "kind": "light_matrix", "camera": look(3.0), "width": 8, "height": 8, "lobes": 1 }),
    )
    .await;
    assert!(!bytes.is_empty(), "the thread is free for the next export");
}
