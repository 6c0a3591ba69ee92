//! Exports over HTTP: their files equal those of the command line, and they are completed despite
//! interruptions.

mod delight;
mod light_matrix;
mod requests;
mod worlds;

use std::fs;
use std::io::Read;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use relume::server::ServerConfig;
use relume::store::Quota;
use relume::testing::{self, TestServer};
use relume_api::exports::{ExportState, ExportView, FramesExport, NewExport, Package};
use relume_api::{ExportId, ModelId};
use relume_client::Client;
use reqwest::{Method, Response, StatusCode, header};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::service_support::{files_under, trained};

async fn post(client: &Client, model: &ModelId, body: &Value) -> Response {
    let path = format!("/v1/models/{model}/exports");
    client.request(Method::POST, &path).unwrap().json(body).send().await.unwrap()
}

pub async fn queued(client: &Client, model: &ModelId, body: &Value) -> ExportView {
    let answer = post(client, model, body).await;
    let (status, text) = (answer.status(), answer.text().await.unwrap());
    assert_eq!(status, StatusCode::ACCEPTED, "{body}: {text}");
    serde_json::from_str(&text).unwrap()
}

pub async fn until(client: &Client, id: &ExportId, done: impl Fn(&ExportView) -> bool) -> ExportView {
    for _ in 0..6000 {
        let export = client.export(id).await.unwrap();
        if done(&export) {
            return export;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    panic!("export {id} never got there");
}

pub async fn ended(client: &Client, id: &ExportId) -> ExportView {
    until(client, id, |export| export.state.is_terminal()).await
}

/// The file of an export that succeeds.
async fn made(client: &Client, model: &ModelId, body: &Value) -> (ExportView, Vec<u8>) {
    let export = queued(client, model, body).await;
    let export = ended(client, &export.id).await;
    assert_eq!(export.state, ExportState::Succeeded, "{body}: {:?}", export.error);
    let bytes = client.export_file(&export.id).await.unwrap().to_vec();
    assert_eq!(export.file.as_ref().unwrap().bytes, bytes.len() as i64);
    (export, bytes)
}

/// A folder with the model's file, under the name in the metadata of its frames.
async fn with_model(client: &Client, model: &ModelId) -> TempDir {
    let folder = TempDir::new().unwrap();
    let file = client.file(model, "model.safetensors").await.unwrap();
    fs::write(folder.path().join(model.as_str()), file).unwrap();
    folder
}

fn relume(folder: &Path, args: &[&str]) {
    let output = Command::new(env!("CARGO_BIN_EXE_relume")).args(args).current_dir(folder).output().unwrap();
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
}

/// Name and bytes of each entry of a zip.
fn entries(bytes: &[u8]) -> Vec<(String, Vec<u8>)> {
    let mut zip = zip::ZipArchive::new(std::io::Cursor::new(bytes)).unwrap();
    let count = zip.len();
    let read = |i| {
        let mut entry = zip.by_index(i).unwrap();
        let mut bytes = Vec::new();
        entry.read_to_end(&mut bytes).unwrap();
        (entry.name().unwrap().into_owned(), bytes)
    };
    (0..count).map(read).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn exported_files_equal_those_of_the_command_line() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let folder = with_model(client, &model).await;
    let sunset = json!({ "builtin": "sunset", "rotation_deg": 30, "exposure_ev": -1 });
    let relit = ["--env", "sunset", "--rotation", "30", "--exposure", "-1", "--relit-degree", "1"];
    let cases: [(Value, &str, &[&str]); 12] = [
        (json!({ "kind": "gltf" }), "a.glb", &[]),
        (json!({ "kind": "gltf", "flatten": true }), "b.glb", &["--flatten"]),
        (json!({ "kind": "mesh", "cells": 24 }), "m.glb", &["--mesh", "--mesh-cells", "24"]),
        (json!({ "kind": "usd" }), "a.usda", &[]),
        (json!({ "kind": "usdz", "layer": "albedo" }), "a.usdz", &["--layer", "albedo"]),
        (json!({ "kind": "ply" }), "a.ply", &[]),
        (json!({ "kind": "ply", "layer": "albedo" }), "b.ply", &["--layer", "albedo"]),
        (json!({ "kind": "ply", "layer": "normal" }), "c.ply", &["--layer", "normal"]),
        (json!({ "kind": "ply", "layer": "roughness" }), "d.ply", &["--layer", "roughness"]),
        (json!({ "kind": "ply", "layer": "metallic" }), "e.ply", &["--layer", "metallic"]),
        (json!({ "kind": "ply", "layer": "relit" }), "f.ply", &["--layer", "relit"]),
        (json!({ "kind": "ply", "environment": sunset, "relit_degree": 1 }), "g.ply", &relit),
    ];
    let mut all: Vec<Vec<u8>> = Vec::new();
    for (body, name, options) in cases {
        let (export, bytes) = made(client, &model, &body).await;
        relume(folder.path(), &[&["export", model.as_str(), "--out", name], options].concat());
        assert!(fs::read(folder.path().join(name)).unwrap() == bytes, "{body}");
        assert!(!all.contains(&bytes), "the control: {body} is none of the others");
        let file = export.file.unwrap();
        assert!(file.name.starts_with(model.as_str()) && file.name.ends_with(&name[2..]), "{}", file.name);
        all.push(bytes);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn exported_frames_equal_those_of_the_command_line() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let folder = with_model(client, &model).await;
    let look = |x: f64| json!({ "camera": { "look_at": { "eye": [x, 1, 1], "target": [0, 0, 0], "fov_y_deg": 40 } } });
    let path = json!({ "width": 32, "height": 16, "cameras": [look(3.0), look(-3.0)] });
    fs::write(folder.path().join("cameras.json"), path.to_string()).unwrap();
    let around = json!({ "kind": "frames", "turntable": { "frames": 4, "azimuth_deg": 10, "elevation_deg": 30 },
        "environment": { "builtin": "sunset", "rotation_deg": 5 }, "environment_turn_deg": 180,
        "width": 24, "height": 16, "background": "#20406f", "tone_curve": "neutral" });
    let exr = json!({ "kind": "frames", "turntable": { "frames": 3, "camera_turn_deg": 90 }, "format": "exr",
        "outputs": ["rgb", "normal", "depth"], "alpha": "straight", "primaries": "acescg", "colour_depth": "half",
        "frames_per_second": 25, "width": 20, "height": 20, "tier": "high" });
    let along =
        json!({ "kind": "frames", "path": path, "format": "jpeg", "environment": { "builtin": "studio" } });
    let cases: [(Value, &str, &[&str]); 3] = [
        (
            around,
            "a/%04d.png",
            &[
                "--turntable",
                "4",
                "--azimuth",
                "10",
                "--elevation",
                "30",
                "--env",
                "sunset",
                "--rotation",
                "5",
                "--env-turn",
                "180",
                "--resolution",
                "24x16",
                "--background",
                "20406f",
                "--tone-curve",
                "neutral",
            ],
        ),
        (
            exr,
            "b/%04d.exr",
            &[
                "--turntable",
                "3",
                "--camera-turn",
                "90",
                "--output",
                "rgb,normal,depth",
                "--alpha",
                "straight",
                "--primaries",
                "acescg",
                "--colour-depth",
                "half",
                "--fps",
                "25",
                "--size",
                "20",
                "--tier",
                "high",
            ],
        ),
        (along, "c/%04d.jpg", &["--path", "cameras.json", "--env", "studio"]),
    ];
    for (body, out, options) in cases {
        let (export, bytes) = made(client, &model, &body).await;
        assert_eq!(export.progress.done, export.progress.total);
        let frames = entries(&bytes);
        assert_eq!(frames.len() as i64, export.progress.total);
        relume(
            folder.path(),
            &[&["render", model.as_str(), "--device", "cpu", "--out", out], options].concat(),
        );
        let at = folder.path().join(Path::new(out).parent().unwrap());
        for (name, bytes) in &frames {
            assert!(fs::read(at.join(name)).unwrap() == *bytes, "{body}: {name}");
        }
        assert!(frames[0].1 != frames[1].1, "the control: {body}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_export_resumes_after_a_restart_without_repeats() {
    let server = testing::spawn().await.unwrap();
    let model = trained(server.client()).await.model.unwrap();
    let body = json!({ "kind": "frames", "turntable": { "frames": 60 }, "width": 256, "height": 256, "tier": "high" });
    let export = queued(server.client(), &model, &body).await;
    until(server.client(), &export.id, |export| export.progress.done >= 3).await;
    let data = server.stop().await.unwrap();

    let work = data.path().join("exports").join(export.id.as_str());
    let is_frame = |path: &Path| path.extension().is_some_and(|e| e == "png");
    let there: Vec<_> =
        fs::read_dir(&work).unwrap().map(|e| e.unwrap().path()).filter(|p| is_frame(p)).collect();
    assert!((3..60).contains(&there.len()), "it was stopped in between: {}", there.len());
    for frame in &there {
        fs::write(frame, "made earlier").unwrap();
    }
    let server = testing::spawn_with(data, |_| {}).await.unwrap();
    let export = ended(server.client(), &export.id).await;
    assert_eq!(export.state, ExportState::Succeeded, "{:?}", export.error);
    let bytes = server.client().export_file(&export.id).await.unwrap();
    let frames = entries(&bytes);
    let (earlier, later): (Vec<_>, Vec<_>) = frames.iter().partition(|(_, bytes)| bytes == b"made earlier");
    assert_eq!((earlier.len(), later.len()), (there.len(), 60 - there.len()));
    assert!(
        later.iter().all(|(_, bytes)| bytes.starts_with(b"\x89PNG")),
        "the control: the others are pictures"
    );
    until_gone(&work).await;
}

/// Waits until a file or folder is removed.
async fn until_gone(path: &Path) {
    for _ in 0..1500 {
        if !path.exists() {
            return;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    panic!("{} stays", path.display());
}

/// A request for an export with more frames than any test waits for.
fn long() -> Value {
    json!({ "kind": "frames", "turntable": { "frames": 10_000 }, "width": 128, "height": 128 })
}

#[tokio::test(flavor = "multi_thread")]
async fn delete_first_cancels_an_export_and_then_removes_it() {
    let change = |config: &mut ServerConfig| config.exports.each = 2;
    let server = testing::spawn_with(TempDir::new().unwrap(), change).await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let [running, waiting] = [queued(client, &model, &long()).await, queued(client, &model, &long()).await];
    let refused = post(client, &model, &json!({ "kind": "ply" })).await;
    assert_eq!(refused.status(), StatusCode::TOO_MANY_REQUESTS, "two may wait or run");
    until(client, &running.id, |export| export.progress.done > 0).await;
    // Other requests are answered during the export.
    client.thumbnail(&model, "size=16").await.unwrap();
    assert_eq!(client.export(&running.id).await.unwrap().state, ExportState::Running);

    let work = server.data_dir().join("exports").join(running.id.as_str());
    assert!(work.exists());
    for export in [&waiting, &running] {
        client.delete_export(&export.id).await.unwrap();
        let cancelled = client.export(&export.id).await.unwrap();
        assert_eq!((cancelled.state, cancelled.file), (ExportState::Cancelled, None));
        assert!(client.export_file(&export.id).await.is_err());
    }
    until_gone(&work).await;
    let (kept, _) = made(client, &model, &json!({ "kind": "ply" })).await;
    let artifact = server.data_dir().join("artifacts/exports").join(kept.id.as_str());
    assert!(artifact.exists());
    assert_eq!(client.exports(Some(&model)).await.unwrap().items.len(), 3);
    for id in [&running.id, &waiting.id, &kept.id] {
        client.delete_export(id).await.unwrap();
        assert_eq!(client.export(id).await.unwrap_err().problem().unwrap().status, 404);
    }
    until_gone(&artifact).await;
    assert!(client.exports(None).await.unwrap().items.is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn exports_are_deleted_with_their_model_and_not_backed_up() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let (export, _) = made(client, &model, &json!({ "kind": "gltf" })).await;
    let running = queued(client, &model, &long()).await;
    until(client, &running.id, |export| export.progress.done > 0).await;
    let copy = TempDir::new().unwrap();
    let database = testing::database_of(server.data_dir()).await.unwrap();
    relume::store::backup(server.data_dir(), database.as_ref(), copy.path(), 0).await.unwrap();
    let copied = files_under(copy.path());
    assert!(copied.iter().all(|(name, _)| !name.contains(export.id.as_str())), "{copied:?}");
    assert!(copied.iter().any(|(name, _)| name.contains("model.safetensors")), "the control");

    client.delete_model(&model).await.unwrap();
    for id in [&export.id, &running.id] {
        assert_eq!(client.export(id).await.unwrap_err().problem().unwrap().status, 404);
    }
    until_gone(&server.data_dir().join("artifacts/exports").join(export.id.as_str())).await;
    until_gone(&server.data_dir().join("exports").join(running.id.as_str())).await;
    let refused = post(client, &model, &json!({ "kind": "gltf" })).await;
    assert_eq!(refused.status(), StatusCode::NOT_FOUND);
    // The next start removes the remains of a killed server.
    let data = server.stop().await.unwrap();
    let left = [
        "exports/01890000-0000-7000-8000-000000000000/0001.png",
        "artifacts/exports/01890000-0000-7000-8000-000000000000",
    ];
    for file in left.map(|file| data.path().join(file)) {
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(file, "left").unwrap();
    }
    let server = testing::spawn_with(data, |_| {}).await.unwrap();
    server.client().models().await.unwrap();
    for file in left {
        until_gone(&server.data_dir().join(file)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn exports_count_towards_usage_and_quota() {
    let server = testing::spawn().await.unwrap();
    let model = trained(server.client()).await.model.unwrap();
    let (export, bytes) = made(server.client(), &model, &json!({ "kind": "ply" })).await;
    let usage = server.client().usage().await.unwrap();
    assert_eq!(
        (usage.exports.count, usage.exports.bytes, usage.unreferenced_bytes),
        (1, bytes.len() as u64, 0)
    );
    let used = usage.captures.bytes + usage.models.bytes + usage.exports.bytes;
    let data = server.stop().await.unwrap();
    let change = |config: &mut ServerConfig| config.quota = Quota { bytes: Some(used + 1000), jobs: None };
    let server = testing::spawn_with(data, change).await.unwrap();
    let client = server.client();
    for body in [json!({ "kind": "ply" }), long()] {
        let refused = queued(client, &model, &body).await;
        let refused = ended(client, &refused.id).await;
        assert_eq!(refused.state, ExportState::Failed);
        assert_eq!(refused.error.unwrap().code, "quota-exceeded", "{body}");
    }
    client.delete_export(&export.id).await.unwrap();
    let (_, again) = made(client, &model, &json!({ "kind": "ply" })).await;
    assert!(again == bytes, "the control: there is room for one");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_invalid_export_request_is_refused_with_a_pointer() {
    let change = |config: &mut ServerConfig| config.exports.ffmpeg = "no-such-ffmpeg".into();
    let server = testing::spawn_with(TempDir::new().unwrap(), change).await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let frames = |more: Value| {
        let mut body = json!({ "kind": "frames", "turntable": { "frames": 2 } });
        body.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        body
    };
    let path = |path: Value| json!({ "kind": "frames", "path": path });
    for (body, pointer) in [
        (json!({}), "/kind"),
        (json!({ "kind": "stl" }), "/kind"),
        (json!({ "kind": "frames" }), "/turntable"),
        (frames(json!({ "path": {} })), "/path"),
        (frames(json!({ "size": 3 })), "/size"),
        (frames(json!({ "turntable": { "frames": 0 } })), "/turntable/frames"),
        (frames(json!({ "turntable": {} })), "/turntable/frames"),
        (frames(json!({ "turntable": { "frames": 2, "elevation_deg": 91 } })), "/turntable/elevation_deg"),
        (frames(json!({ "width": 16 })), "/height"),
        (frames(json!({ "width": 16, "height": 5000 })), "/height"),
        (frames(json!({ "format": "gif" })), "/format"),
        (frames(json!({ "format": "jpeg", "outputs": ["depth"] })), "/outputs"),
        (frames(json!({ "alpha": "straight" })), "/alpha"),
        (frames(json!({ "environment": { "builtin": "moon" } })), "/environment/builtin"),
        (frames(json!({ "environment": { "id": "none" } })), "/environment/id"),
        (frames(json!({ "environment": { "inline_base64": "AA==" } })), "/environment/inline_base64"),
        (frames(json!({ "tier": "monte_carlo", "samples": 60_000 })), "/samples"),
        (frames(json!({ "package": "mp4" })), "/package"),
        (path(json!({})), "/path"),
        (path(json!({ "cameras": [] })), "/path"),
        (path(json!({ "cameras": [{ "camera": {} }] })), "/path/cameras/0/camera"),
        (json!({ "kind": "ply", "layer": "depth" }), "/layer"),
        (json!({ "kind": "ply", "layer": "albedo", "environment": {} }), "/environment"),
        (json!({ "kind": "ply", "environment": { "builtin": "moon" } }), "/environment/builtin"),
        (json!({ "kind": "ply", "relit_degree": 4 }), "/relit_degree"),
        (json!({ "kind": "ply", "cells": 4 }), "/cells"),
        (json!({ "kind": "mesh", "cells": 8 }), "/cells"),
    ] {
        let refused = post(client, &model, &body).await;
        let status = refused.status().as_u16();
        let problem: Value = serde_json::from_str(&refused.text().await.unwrap()).unwrap();
        assert_eq!((status, &problem["errors"][0]["pointer"]), (422, &json!(pointer)), "{body}: {problem}");
        if pointer == "/package" {
            assert!(problem["errors"][0]["detail"].as_str().unwrap().contains("ffmpeg"), "{problem}");
        }
    }
    assert!(client.exports(None).await.unwrap().items.is_empty(), "nothing was queued");
    made(client, &model, &frames(json!({ "width": 8, "height": 8 }))).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn exports_are_idempotent_and_their_files_support_ranges() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let frames = FramesExport { width: Some(8), height: Some(8), ..FramesExport::turntable(2) };
    let wanted = NewExport::Frames(Box::new(frames.clone()));
    let first = client.create_export(&model, &wanted, Some("a")).await.unwrap();
    assert_eq!(client.create_export(&model, &wanted, Some("a")).await.unwrap().id, first.id);
    let other = NewExport::Frames(Box::new(FramesExport { width: Some(16), height: Some(16), ..frames }));
    let reused = client.create_export(&model, &other, Some("a")).await.unwrap_err();
    assert!(reused.problem().unwrap().kind.ends_with("idempotency-key-reused"));
    let answer = post(client, &model, &json!({ "kind": "ply" })).await;
    let location = answer.headers()[header::LOCATION].to_str().unwrap().to_owned();
    let second: ExportView = serde_json::from_str(&answer.text().await.unwrap()).unwrap();
    assert_eq!(location, format!("/v1/exports/{}", second.id));
    assert_ne!(second.id, first.id);

    let export = client.wait_for_export(&first.id, |_| {}).await.unwrap();
    let file = export.file.unwrap();
    let get =
        |name: &str, value: &str| client.request(Method::GET, &file.href).unwrap().header(name, value).send();
    let whole = get("accept", "*/*").await.unwrap();
    let tag = whole.headers()[header::ETAG].to_str().unwrap().to_owned();
    let disposition = whole.headers()[header::CONTENT_DISPOSITION].to_str().unwrap().to_owned();
    assert_eq!(
        (tag.as_str(), disposition),
        (&*format!("\"{}\"", file.sha256), format!("attachment; filename=\"{model}.zip\""))
    );
    let bytes = whole.bytes().await.unwrap();
    let part = get("range", "bytes=2-5").await.unwrap();
    assert_eq!((part.status().as_u16(), &part.bytes().await.unwrap()[..]), (206, &bytes[2..6]));
    assert_eq!(get("if-none-match", &tag).await.unwrap().status(), StatusCode::NOT_MODIFIED);
    let page = client.request(Method::GET, "/v1/exports?limit=1").unwrap().send().await.unwrap();
    let page: Value = serde_json::from_str(&page.text().await.unwrap()).unwrap();
    let next = page["next"].as_str().unwrap();
    let rest = client.request(Method::GET, &format!("/v1/exports?before={next}&state=succeeded")).unwrap();
    let rest: Value = serde_json::from_str(&rest.send().await.unwrap().text().await.unwrap()).unwrap();
    assert_eq!((&page["items"][0]["id"], &rest["items"][0]["id"]), (&json!(second.id), &json!(first.id)));
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs ffmpeg with libx264, and ffprobe"]
async fn a_video_export_shows_the_same_frames_as_the_zip() {
    let server: TestServer = testing::spawn().await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let frames = FramesExport { width: Some(64), height: Some(48), ..FramesExport::turntable(5) };
    let frames = FramesExport { package: Package::Mp4, frames_per_second: Some(10), ..frames };
    let mut body = serde_json::to_value(NewExport::Frames(Box::new(frames))).unwrap();
    let (export, video) = made(client, &model, &body).await;
    assert_eq!(export.file.unwrap().content_type, "video/mp4");
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("a.mp4");
    fs::write(&file, &video).unwrap();
    let probe = [
        "-v",
        "error",
        "-count_frames",
        "-show_entries",
        "stream=codec_name,width,height,color_range,color_space,color_transfer,color_primaries,r_frame_rate,nb_read_frames",
    ];
    let told = Command::new("ffprobe").args(probe).args(["-of", "csv=p=0"]).arg(&file).output().unwrap();
    assert_eq!(String::from_utf8_lossy(&told.stdout).trim(), "h264,64,48,tv,bt709,bt709,bt709,10/1,5");
    // The first image equals the first frame of a zip over white, within the loss of the codec.
    let picture = folder.path().join("first.png");
    let first = ["-v", "error", "-frames:v", "1", "-y"];
    let done = Command::new("ffmpeg").arg("-i").arg(&file).args(first).arg(&picture).status().unwrap();
    assert!(done.success());
    let pixels = |bytes: &[u8]| image::load_from_memory(bytes).unwrap().into_rgb8().into_raw();
    let seen = pixels(&fs::read(&picture).unwrap());
    body["package"] = json!("zip");
    body["background"] = json!("#ffffff");
    let frames = entries(&made(client, &model, &body).await.1);
    let off = |frame: &[u8]| {
        let pairs = pixels(frame).into_iter().zip(&seen);
        pairs.map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / seen.len() as f64
    };
    assert!(off(&frames[0].1) < 4.0, "{}", off(&frames[0].1));
    let black = entries(&made(client, &model, &json!({ "kind": "frames", "turntable": { "frames": 1 }, "width": 64, "height": 48, "background": "#000000" })).await.1);
    assert!(off(&black[0].1) > 20.0, "the control: over black");
    body["width"] = json!(63);
    body["package"] = json!("mp4");
    let odd = post(client, &model, &body).await;
    assert_eq!(odd.status(), StatusCode::UNPROCESSABLE_ENTITY);
    let problem: Value = serde_json::from_str(&odd.text().await.unwrap()).unwrap();
    assert_eq!(problem["errors"][0]["pointer"], "/width");
}
