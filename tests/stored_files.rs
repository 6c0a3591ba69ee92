//! Stored files that are damaged, missing or left over.

use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use relume::testing::{self, TestServer};
use relume_api::Problem;
use relume_api::jobs::JobState;
use reqwest::Method;
use reqwest::header::{CONTENT_TYPE, ETAG, IF_NONE_MATCH};
use serde_json::json;

use crate::service_support::{capture_zip, ended, files_under, small_job, trained, until};

/// The stored file whose name ends with `end`.
fn artifact(data: &Path, end: &str) -> PathBuf {
    let files = files_under(data);
    let (name, _) = files.iter().find(|(name, _)| name.ends_with(end)).unwrap_or_else(|| panic!("{files:?}"));
    data.join(name)
}

/// Flips the last 200 bytes of a file and returns its original content.
fn damage(path: &Path) -> Vec<u8> {
    let sound = std::fs::read(path).unwrap();
    let mut bytes = sound.clone();
    bytes.iter_mut().rev().take(200).for_each(|byte| *byte ^= 0x55);
    std::fs::write(path, bytes).unwrap();
    sound
}

async fn get(server: &TestServer, path: &str) -> reqwest::Response {
    server.client().request(Method::GET, path).unwrap().send().await.unwrap()
}

async fn is_damaged(answer: reqwest::Response) -> bool {
    let status = answer.status().as_u16();
    assert!(answer.headers().get(ETAG).is_none());
    let problem: Problem = serde_json::from_slice(&answer.bytes().await.unwrap()).unwrap();
    (status, problem.kind.as_str()) == (500, "urn:relume:problem:artifact-damaged")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_model_is_neither_served_nor_rendered() {
    let server = testing::spawn().await.unwrap();
    let model = trained(server.client()).await.model.unwrap();
    let file = format!("/v1/models/{model}/files/model.safetensors");
    let thumbnail = format!("/v1/models/{model}/thumbnail?size=16");
    let render = async || {
        let camera = json!({ "look_at": { "eye": [3, 0, 1], "target": [0, 0, 0], "fov_y_deg": 40 } });
        let body = json!({ "camera": camera, "width": 16, "height": 16 }).to_string();
        let request = server.client().request(Method::POST, &format!("/v1/models/{model}/render")).unwrap();
        request.header(CONTENT_TYPE, "application/json").body(body).send().await.unwrap()
    };
    let sound_answer = get(&server, &file).await;
    assert_eq!(sound_answer.status(), 200);
    let tag = sound_answer.headers()[ETAG].clone();
    assert_eq!([get(&server, &thumbnail).await.status(), render().await.status()], [200, 200]);

    let path = artifact(server.data_dir(), "model.safetensors");
    let sound = damage(&path);
    for _ in 0..2 {
        assert!(is_damaged(get(&server, &file).await).await);
        assert!(is_damaged(get(&server, &thumbnail).await).await);
        assert!(is_damaged(render().await).await);
    }
    let part = server.client().request(Method::GET, &file).unwrap().header("range", "bytes=0-9");
    assert!(is_damaged(part.send().await.unwrap()).await, "nor a part that is sound itself");
    let known = server.client().request(Method::GET, &file).unwrap().header(IF_NONE_MATCH, tag);
    assert_eq!(known.send().await.unwrap().status(), 304, "who has the sound file may keep it");
    let other = format!("/v1/models/{model}/files/model.ply");
    assert_eq!(get(&server, &other).await.status(), 200, "the other file is sound");

    std::fs::write(&path, sound).unwrap();
    assert_eq!(get(&server, &file).await.status(), 200, "a file that was put back is served");
    std::fs::remove_file(&path).unwrap();
    assert!(is_damaged(get(&server, &file).await).await, "a missing one too is a problem of the server");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_capture_fails_its_job_and_a_new_upload_repairs_it() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    damage(&artifact(server.data_dir(), &capture.sha256));
    let job = client.create_job(&small_job(&capture.id, 5, 5), None).await.unwrap();
    let failed = ended(client, &job.id).await;
    let code = failed.error.map(|error| error.code);
    assert_eq!((failed.state, code.as_deref()), (JobState::Failed, Some("artifact_damaged")));
    assert_eq!(client.upload_capture_bytes(capture_zip()).await.unwrap().id, capture.id);
    let job = client.create_job(&small_job(&capture.id, 5, 5), None).await.unwrap();
    assert_eq!(ended(client, &job.id).await.state, JobState::Succeeded);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_environment_is_not_used() {
    let server = testing::spawn().await.unwrap();
    let client = server.client();
    let model = trained(client).await.model.unwrap();
    let map = hdr();
    let upload = client.request(Method::POST, "/v1/environments").unwrap();
    let upload = upload.header(CONTENT_TYPE, "image/vnd.radiance").body(map).send().await.unwrap();
    let view: serde_json::Value = serde_json::from_slice(&upload.bytes().await.unwrap()).unwrap();
    let url = format!("/v1/models/{model}/thumbnail?size=16&env={}", view["id"].as_str().unwrap());
    assert_eq!(get(&server, &url).await.status(), 200);
    damage(&artifact(server.data_dir(), view["sha256"].as_str().unwrap()));
    assert!(is_damaged(get(&server, &url).await).await);
}

/// A grey map of 32 x 16 pixels, in Radiance format without run lengths.
fn hdr() -> Vec<u8> {
    let mut bytes = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 16 +X 32\n".to_vec();
    bytes.extend([128, 128, 128, 129].repeat(32 * 16));
    bytes
}

#[tokio::test(flavor = "multi_thread")]
async fn training_starts_over_if_its_checkpoint_is_damaged() {
    let server = testing::spawn().await.unwrap();
    let capture = server.client().upload_capture_bytes(capture_zip()).await.unwrap();
    let job = server.client().create_job(&small_job(&capture.id, 2000, 100_000), None).await.unwrap();
    until(server.client(), &job.id, |job| job.progress.step > 0).await;
    let data = server.stop().await.unwrap();
    let name = files_under(data.path()).into_iter().find(|(name, _)| name.contains("/checkpoint-"));
    damage(&data.path().join(name.expect("the shutdown made a checkpoint").0));
    let server = testing::spawn_with(data, |_| {}).await.unwrap();
    let mut warnings = Vec::new();
    let listen = |event: &relume_client::JobEvent| {
        if event.kind == "warning" {
            warnings.push(event.data["message"].to_string());
        }
    };
    server.client().wait(&job.id, listen).await.unwrap();
    assert!(warnings.iter().any(|w| w.contains("the training restarts")), "{warnings:?}");
    assert_eq!(ended(server.client(), &job.id).await.state, JobState::Succeeded);
}

#[tokio::test(flavor = "multi_thread")]
async fn startup_cleanup_moves_aside_only_orphaned_files() {
    let server = testing::spawn().await.unwrap();
    let job = trained(server.client()).await.id;
    let data = server.stop().await.unwrap();
    let root = data.path().join("artifacts");
    let before = files_under(&root);
    assert_eq!(before.len(), 3, "a capture and two files of a model: {before:?}");
    let write = |key: &str| {
        std::fs::create_dir_all(root.join(key).parent().unwrap()).unwrap();
        std::fs::write(root.join(key), "left over").unwrap();
    };
    // Files of a known job that a kill leaves during the publication of a model or the write of a checkpoint.
    write(&format!("attempts/{job}/9/model.safetensors"));
    write(&format!("attempts/{job}/9/checkpoint-00000010.safetensors#1"));
    // Files that belong to no known resource.
    let (unknown, other) = (format!("captures/{}", "a".repeat(64)), "attempts/some-job/1/model.ply");
    write(&unknown);
    write(other);
    // A file that belongs to no known resource and was already moved to the orphans folder, as a link to the
    // same file.
    let twice = format!("captures/{}", "c".repeat(64));
    write(&twice);
    std::fs::create_dir_all(root.join("orphans/captures")).unwrap();
    std::fs::hard_link(root.join(&twice), root.join("orphans").join(&twice)).unwrap();
    // Names that this program does not create.
    write("captures/notes.txt");
    write("readme");
    // Moved to the orphans folder eight days ago.
    write("orphans/captures/old");
    let long_ago = SystemTime::now() - Duration::from_secs(8 * 24 * 3600);
    let old = std::fs::File::options().write(true).open(root.join("orphans/captures/old")).unwrap();
    old.set_modified(long_ago).unwrap();

    let server = testing::spawn_with(data, |_| {}).await.unwrap();
    server.client().models().await.unwrap();
    let mut expected: Vec<String> = before.into_iter().map(|(name, _)| name).collect();
    let kept = ["captures/notes.txt".to_owned(), "readme".to_owned()];
    expected
        .extend(kept.into_iter().chain([&unknown[..], other, &twice].map(|name| format!("orphans/{name}"))));
    expected.sort();
    let after: Vec<String> = files_under(&root).into_iter().map(|(name, _)| name).collect();
    assert_eq!(after, expected);
    assert!(!root.join("attempts/some-job").exists(), "empty folders are gone too");
    let model = server.client().job(&job).await.unwrap().model.unwrap();
    server.client().file(&model, "model.safetensors").await.unwrap();
}
