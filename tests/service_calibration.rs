//! Calibration of finished models over HTTP: everything that shows the model changes, and an undo gives it back.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use relume::jobs::ManualClock;
use relume::testing::{self, TestServer};
use relume_api::calibration::{CalibrationView, NewCalibration, Patch};
use relume_api::models::ModelView;
use relume_api::renders::RenderRequest;
use relume_api::{CaptureId, ModelId};
use relume_capture::formats::{image_file, model_file};
use relume_client::Client;
use relume_compare::largest_difference;
use relume_scene::{Model, softplus, srgb};
use relume_spec::rendering::{FrameFormat, Output};
use reqwest::{Method, StatusCode, header};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::service_exports::{ended, queued, until};
use crate::service_support::{files_under, trained};

const PHOTO: &str = "train/r_0.png";

/// A calibration by the middle of the ball in the first photograph.
pub fn middle(reflectance: [f32; 3]) -> NewCalibration {
    let patch = Patch { photo: PHOTO.to_owned(), x: 14, y: 14, width: 4, height: 4 };
    NewCalibration { patch, reflectance }
}

async fn calibrated(client: &Client, model: &ModelId, reflectance: [f32; 3]) -> CalibrationView {
    client.calibrate(model, &middle(reflectance)).await.unwrap().calibration.unwrap()
}

/// Mean albedo of the model in the middle of the first photograph, from a rendered picture.
async fn albedo(client: &Client, model: &ModelId, capture: &CaptureId) -> [f32; 3] {
    let path = format!("/v1/captures/{capture}/cameras");
    let listed: Value =
        client.request(Method::GET, &path).unwrap().send().await.unwrap().json().await.unwrap();
    let cameras = listed["cameras"].as_array().unwrap();
    let camera = cameras.iter().find(|camera| camera["name"] == PHOTO).unwrap()["camera"].clone();
    let camera = serde_json::from_value(camera).unwrap();
    let request = RenderRequest {
        camera,
        width: 32,
        height: 32,
        outputs: vec![Output::Albedo],
        ..RenderRequest::default()
    };
    let png = client.render(model, &request, FrameFormat::Png).await.unwrap();
    let image = image_file::decode(&png, 1024).unwrap();
    let inside = (14..18).flat_map(|y| (14..18).map(move |x| y * 32 + x));
    let pixels: Vec<_> = inside.map(|at| image.pixels[at]).collect();
    std::array::from_fn(|c| pixels.iter().map(|pixel| srgb::decode(pixel[c])).sum::<f32>() / 16.0)
}

async fn model_of(client: &Client, model: &ModelId) -> Model {
    model_file::decode(&client.file(model, "model.safetensors").await.unwrap()).unwrap()
}

/// The largest relative difference of prototypes and light between two models.
fn largest_change(a: &Model, b: &Model) -> f64 {
    let values = |m: &Model| -> Vec<f32> {
        m.prototypes.iter().copied().chain(m.env_raw.iter().map(|raw| raw.map(softplus))).flatten().collect()
    };
    let ratios: Vec<f32> = values(a).iter().zip(values(b)).map(|(a, b)| a / b).collect();
    largest_difference(&ratios, &vec![1.0; ratios.len()])
}

/// What a client knows of everything that shows the model: tag and bytes, by path.
async fn shown(client: &Client, model: &ModelId) -> Vec<(String, String, Vec<u8>)> {
    let mut shown = Vec::new();
    for part in
        ["thumbnail?size=64&env=studio", "stream", "light", "files/model.safetensors", "files/model.ply"]
    {
        let path = format!("/v1/models/{model}/{part}");
        let answer = client.request(Method::GET, &path).unwrap().send().await.unwrap();
        assert_eq!(answer.status(), StatusCode::OK, "{part}");
        let text = |name| answer.headers()[name].to_str().unwrap().to_owned();
        let (tag, cache) = (text(header::ETAG), text(header::CACHE_CONTROL));
        assert!(cache.ends_with("no-cache"), "{part}: {cache}");
        shown.push((path, tag, answer.bytes().await.unwrap().to_vec()));
    }
    shown
}

fn hashes(view: &ModelView) -> Vec<&str> {
    view.files.iter().map(|file| file.sha256.as_str()).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn calibrated_model_shows_the_reflectance_everywhere() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let job = trained(client).await;
    let model = job.model.unwrap();
    let before = (client.model(&model).await.unwrap(), model_of(client, &model).await);
    assert_eq!(before.0.calibration, None);
    let (old, was) = (shown(client, &model).await, albedo(client, &model, &job.capture).await);

    // Darker than the trained albedo: pictures limit albedo to 1, so bright surfaces of a rough model are inexact.
    let wanted = [0.3, 0.2, 0.1];
    let view = client.calibrate(&model, &middle(wanted)).await.unwrap();
    let done = view.calibration.clone().unwrap();
    assert_eq!((done.reflectance, done.total_scale), (wanted, Some(done.scale)));
    assert_eq!(client.model(&model).await.unwrap(), view);
    assert!(hashes(&view).iter().zip(hashes(&before.0)).all(|(new, old)| *new != old));
    assert_eq!(view.card["figures"], before.0.card["figures"], "figures of the training stay");
    assert!(view.card["training_seconds"].is_number());
    let now = albedo(client, &model, &job.capture).await;
    assert!(largest_difference(&now, &wanted) < 0.01, "{now:?}");
    assert!(largest_difference(&was, &wanted) > 0.05, "the control: {was:?}");
    let ratio: [f32; 3] = std::array::from_fn(|c| now[c] / was[c] / done.scale[c]);
    assert!(largest_difference(&ratio, &[1.0; 3]) < 0.05, "{ratio:?}");
    for ((path, tag, bytes), (_, old_tag, old_bytes)) in shown(client, &model).await.iter().zip(&old) {
        assert!(tag != old_tag && bytes != old_bytes, "{path}");
        let known = client.request(Method::GET, path).unwrap().header(header::IF_NONE_MATCH, old_tag);
        assert_eq!(known.send().await.unwrap().status(), StatusCode::OK, "{path}");
        let control = client.request(Method::GET, path).unwrap().header(header::IF_NONE_MATCH, tag);
        assert_eq!(control.send().await.unwrap().status(), StatusCode::NOT_MODIFIED, "{path}");
    }

    let again = calibrated(client, &model, wanted).await;
    assert!(largest_difference(&again.scale, &[1.0; 3]) < 1e-3, "{again:?}");
    let other = calibrated(client, &model, [0.15; 3]).await;
    let total: [f32; 3] = std::array::from_fn(|c| done.scale[c] * again.scale[c] * other.scale[c]);
    assert!(largest_difference(&other.total_scale.unwrap(), &total) < 1e-4);
    assert!(largest_change(&model_of(client, &model).await, &before.1) > 0.1, "the control");

    let undone = client.undo_calibration(&model).await.unwrap();
    assert_eq!((&undone.calibration, &undone.card), (&None, &before.0.card));
    assert!(largest_change(&model_of(client, &model).await, &before.1) < 1e-5);
    assert!(largest_difference(&albedo(client, &model, &job.capture).await, &was) < 0.005);
    assert_eq!(hashes(&client.undo_calibration(&model).await.unwrap()), hashes(&undone), "nothing is left");
}

#[tokio::test(flavor = "multi_thread")]
async fn concurrent_calibrations_of_a_model_do_not_mix() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let before = model_of(client, &model).await;
    let all = [[0.2, 0.1, 0.15], [0.25, 0.2, 0.1], [0.1, 0.15, 0.2], [0.05, 0.1, 0.12]];
    let views = futures::future::join_all(all.map(|wanted| calibrated(client, &model, wanted))).await;
    let last = client.model(&model).await.unwrap().calibration.unwrap();
    assert!(views.contains(&last), "{last:?}");
    for view in &views {
        let first = views.iter().find(|one| one.total_scale == Some(one.scale)).unwrap();
        // Whatever the order: the product of all factors leads from the first albedo to the known reflectance.
        let found: [f32; 3] = std::array::from_fn(|c| first.albedo_before[c] * view.total_scale.unwrap()[c]);
        assert!(largest_difference(&found, &view.reflectance) < 1e-3, "{view:?} {found:?}");
    }
    client.undo_calibration(&model).await.unwrap();
    assert!(largest_change(&model_of(client, &model).await, &before) < 1e-5);
}

/// Status, kind and field of the refusal of a body.
async fn refusal(client: &Client, model: &str, body: &Value) -> (u16, String, String) {
    let path = format!("/v1/models/{model}/calibration");
    let answer = client.request(Method::PUT, &path).unwrap().json(body).send().await.unwrap();
    let status = answer.status().as_u16();
    let problem: Value = answer.json().await.unwrap();
    let kind = problem["type"].as_str().unwrap().trim_start_matches("urn:relume:problem:").to_owned();
    let field = problem["errors"][0]["pointer"].as_str().unwrap_or_default().to_owned();
    (status, kind, if field.is_empty() { problem["detail"].to_string() } else { field })
}

#[tokio::test(flavor = "multi_thread")]
async fn refused_calibrations_name_the_field_and_change_nothing() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let job = trained(client).await;
    let model = job.model.unwrap();
    let before = client.model(&model).await.unwrap();
    let body = |change: fn(&mut Value)| {
        let mut body = json!(middle([0.18; 3]));
        change(&mut body);
        body
    };
    for (body, field) in [
        (body(|b| b["patch"]["photo"] = json!("none.png")), "/patch/photo"),
        (body(|b| b["patch"]["x"] = json!(30)), "/patch/width"),
        (body(|b| b["patch"]["y"] = json!(30)), "/patch/height"),
        (body(|b| b["patch"]["width"] = json!(0)), "/patch/width"),
        (body(|b| b["patch"]["x"] = json!(1.5)), "/patch/x"),
        (body(|b| b["patch"] = json!({ "photo": PHOTO, "x": 0, "y": 0, "width": 2, "height": 2 })), "/patch"),
        (body(|b| b["patch"]["reflectance"] = json!(0.2)), "/patch/reflectance"),
        (body(|b| b["reflectance"] = json!([0.2, 0.2, 1.5])), "/reflectance"),
        (body(|b| b["reflectance"] = json!("white")), "/reflectance"),
    ] {
        let (status, kind, found) = refusal(client, model.as_str(), &body).await;
        assert_eq!((status, kind.as_str(), found.as_str()), (422, "invalid-field", field), "{body}");
    }
    let whole = body(|_| {});
    let unknown = refusal(client, "01890000-0000-7000-8000-000000000000", &whole).await;
    assert_eq!((unknown.0, unknown.1.as_str()), (404, "not-found"));
    assert_eq!(client.model(&model).await.unwrap(), before);
    client.calibrate(&model, &middle([0.18; 3])).await.unwrap();

    client.delete_capture(&job.capture, false).await.unwrap();
    let (status, kind, detail) = refusal(client, model.as_str(), &whole).await;
    assert_eq!((status, kind.as_str()), (409, "capture-deleted"));
    assert!(detail.contains("relume calibrate"), "{detail}");
    let undone = client.undo_calibration(&model).await.unwrap();
    assert_eq!(undone.card, before.card, "an undo needs no photographs");
}

/// The artifacts of models, without those of attempts that trained them.
fn replaced(data: &Path) -> usize {
    files_under(&data.join("artifacts/models")).len()
}

fn artifacts(data: &Path) -> usize {
    files_under(&data.join("artifacts")).len()
}

async fn until_there_are(count: usize, data: &Path) {
    for _ in 0..1500 {
        if artifacts(data) == count {
            return;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    panic!("{count} artifacts were expected: {:?}", files_under(&data.join("artifacts")));
}

/// Waits for a folder to go: the server removes it after its last file.
async fn until_removed(folder: &Path) {
    for _ in 0..1500 {
        if !folder.exists() {
            return;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    panic!("{} is left", folder.display());
}

#[tokio::test(flavor = "multi_thread")]
async fn replaced_files_are_removed_after_a_while_or_a_restart() {
    let clock = Arc::new(ManualClock::default());
    let start = async |data: TempDir| -> TestServer {
        testing::spawn_with(data, |config| config.clock = clock.clone()).await.unwrap()
    };
    let server = start(TempDir::new().unwrap()).await;
    let model = trained(server.client()).await.model.unwrap();
    let count = artifacts(server.data_dir());
    calibrated(server.client(), &model, [0.2; 3]).await;
    assert_eq!((artifacts(server.data_dir()), replaced(server.data_dir())), (count + 2, 2));
    tokio::time::sleep(Duration::from_secs(1)).await;
    assert_eq!(artifacts(server.data_dir()), count + 2, "requests may still read the old files");
    clock.advance(Duration::from_secs(3600));
    // The garbage collector also runs after a deletion.
    let other = trained_again(&server).await;
    let count_of_both = artifacts(server.data_dir());
    server.client().delete_model(&other).await.unwrap();
    until_there_are(count, server.data_dir()).await;
    assert!(count_of_both > count);

    calibrated(server.client(), &model, [0.3; 3]).await;
    assert_eq!(replaced(server.data_dir()), 4);
    let data = server.stop().await.unwrap();
    let left = data.path().join(format!("artifacts/models/{model}/01890000-0000-7000-8000-000000000000"));
    std::fs::create_dir_all(&left).unwrap();
    std::fs::write(left.join("model.ply"), "written before a kill").unwrap();
    let server = start(data).await;
    let view = server.client().model(&model).await.unwrap();
    assert_eq!(view.calibration.unwrap().reflectance, [0.3; 3]);
    assert_eq!((artifacts(server.data_dir()), replaced(server.data_dir())), (count, 2));
    server.client().file(&model, "model.ply").await.unwrap();
    server.client().delete_model(&model).await.unwrap();
    until_there_are(count - 2, server.data_dir()).await;
    until_removed(&server.data_dir().join("artifacts/models").join(model.as_str())).await;
}

/// Another model, of the same capture.
async fn trained_again(server: &TestServer) -> ModelId {
    trained(server.client()).await.model.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn running_exports_begin_again_with_the_calibrated_model() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let body = json!({ "kind": "frames", "turntable": { "frames": 40 }, "width": 128, "height": 128,
                       "environment": { "builtin": "studio" } });
    let export = queued(client, &model, &body).await;
    until(client, &export.id, |export| export.progress.done >= 2).await;
    let first = server.data_dir().join("exports").join(export.id.as_str()).join("0001.png");
    let uncalibrated = std::fs::read(first).unwrap();
    calibrated(client, &model, [0.05, 0.5, 0.9]).await;
    let (export, control) = (ended(client, &export.id).await, queued(client, &model, &body).await);
    assert!(export.error.is_none(), "{:?}", export.error);
    let control = ended(client, &control.id).await;
    let [frames, wanted] = [&export, &control].map(|export| export.file.as_ref().unwrap().sha256.clone());
    assert_eq!(frames, wanted, "all frames show the calibrated model");
    let zip = client.export_file(&export.id).await.unwrap();
    let mut zip = zip::ZipArchive::new(std::io::Cursor::new(zip)).unwrap();
    let mut bytes = Vec::new();
    std::io::copy(&mut zip.by_name("0001.png").unwrap(), &mut bytes).unwrap();
    assert_ne!(bytes, uncalibrated, "the control: the frame before the calibration is another");
}
