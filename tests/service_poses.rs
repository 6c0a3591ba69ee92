//! Photographs without poses that are sent to a server, with COLMAP and with its failures. A script replaces
//! COLMAP; one ignored test uses the real program.

#![cfg(unix)]

use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use relume::server::PosesPolicy;
use relume::store::hex;
use relume::testing::{self, TestServer};
use relume_api::CaptureId;
use relume_api::cameras::CameraConvention;
use relume_api::captures::{CaptureState, CaptureSummary, PosesStage};
use relume_api::jobs::NewJob;
use relume_capture::{ImportLimits, cameras};
use relume_client::Client;
use relume_spec::training::UpAxis;
use relume_train::eval::PoseErrors;
use reqwest::Method;
use reqwest::multipart::{Form, Part};
use sha2::{Digest, Sha256};
use tempfile::TempDir;

use crate::poses::{COPY, Place};
use crate::server_process::Server;
use crate::service_support::{files_under, zip_of};
use relume_fixtures::data;
use relume_fixtures::small_set::picture;

const PHOTOGRAPHS: usize = 8;
/// Shell code that waits until the file `gate` exists.
const WAIT: &str = "while [ ! -e \"$(dirname \"$0\")/gate\" ]; do sleep 0.05; done";
/// Shell code that writes the process id and never ends.
const HANG: &str = "echo $$ > \"$(dirname \"$0\")/pid\"; while :; do sleep 0.2; done";

fn photographs(first: usize) -> Vec<(String, Vec<u8>)> {
    (0..PHOTOGRAPHS).map(|i| (format!("{i}.png"), picture(first + i))).collect()
}

async fn server_on(data: TempDir, place: &Place, change: impl FnOnce(&mut PosesPolicy)) -> TestServer {
    let program = place.at("bin/colmap");
    let with_poses = |config: &mut relume::server::ServerConfig| {
        config.poses = PosesPolicy { is_on: true, program, ..PosesPolicy::default() };
        change(&mut config.poses);
    };
    testing::spawn_with(data, with_poses).await.unwrap()
}

async fn server(place: &Place) -> TestServer {
    server_on(TempDir::new().unwrap(), place, |_| {}).await
}

/// The capture when `done` is true.
async fn until(client: &Client, id: &CaptureId, done: impl Fn(&CaptureSummary) -> bool) -> CaptureSummary {
    for _ in 0..3000 {
        let capture = client.capture(id).await.unwrap();
        if done(&capture) {
            return capture;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    panic!("{id} never got there: {:?}", client.capture(id).await);
}

async fn ended(client: &Client, id: &CaptureId) -> CaptureSummary {
    until(client, id, |capture| capture.state != CaptureState::Validating).await
}

fn stage(capture: &CaptureSummary) -> Option<PosesStage> {
    capture.poses.map(|poses| poses.stage)
}

fn is_running(pid: &str) -> bool {
    Command::new("sh").args(["-c", &format!("kill -0 {pid} 2>/dev/null")]).status().unwrap().success()
}

/// Waits for the process that a script with [`HANG`] became.
async fn hanging(place: &Place) -> String {
    for _ in 0..1500 {
        match fs::read_to_string(place.at("bin/pid")) {
            Ok(pid) if pid.ends_with('\n') => return pid.trim().to_owned(),
            _ => tokio::time::sleep(Duration::from_millis(20)).await,
        }
    }
    panic!("the script never began");
}

async fn gone(pid: &str) {
    for _ in 0..1500 {
        if !is_running(pid) {
            return;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    panic!("{pid} runs on");
}

/// Checks that only these files remain.
async fn left(data: &Path, wanted: &[String]) {
    let names = || -> Vec<String> { files_under(data).into_iter().map(|(name, _)| name).collect() };
    for _ in 0..500 {
        if names() == wanted {
            return;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert_eq!(names(), wanted);
}

fn problem_code(capture: &CaptureSummary) -> (&str, &str) {
    let problem = capture.problem.as_ref().unwrap();
    let code = problem.content.as_ref().map_or("", |content| content.code.as_str());
    (code, problem.detail.as_deref().unwrap_or_default())
}

#[tokio::test(flavor = "multi_thread")]
async fn photographs_without_poses_become_one_posed_capture() {
    let place = Place::new("3.8", ":", COPY);
    let server = server(&place).await;
    let client = server.client();
    let archive = zip_of(&photographs(0));
    let request = client.request(Method::POST, "/v1/captures?name=Lion").unwrap();
    let answer =
        request.header("content-type", "application/zip").body(archive.clone()).send().await.unwrap();
    assert_eq!(answer.status(), 202, "nobody asked for that, but poses take long");
    assert!(!answer.headers().contains_key("preference-applied"));
    let begun: CaptureSummary = serde_json::from_str(&answer.text().await.unwrap()).unwrap();
    assert_eq!(stage(&begun), Some(PosesStage::Waiting));
    let made = ended(client, &begun.id).await;
    assert_eq!(
        (made.state, made.report.layout.as_str()),
        (CaptureState::Ready, "colmap"),
        "{:?}",
        made.problem
    );
    assert_eq!((&made.id, made.metadata.name.as_deref()), (&begun.id, Some("Lion")));
    assert_eq!(made.report.train_images + made.report.test_images, PHOTOGRAPHS);
    let sent = hex(&Sha256::digest(&archive));
    assert_eq!(made.made_of.as_ref(), Some(&sent));
    assert_ne!(made.sha256, sent);
    // The posed capture is stored under its own hash and counts as stored.
    let file = server.data_dir().join(format!("artifacts/captures/{}", made.sha256));
    left(server.data_dir(), &[format!("artifacts/captures/{}", made.sha256)]).await;
    let bytes = fs::read(file).unwrap();
    assert_eq!((hex(&Sha256::digest(&bytes)), bytes.len() as i64), (made.sha256.clone(), made.bytes));
    assert_eq!(client.usage().await.unwrap().captures.bytes, made.bytes as u64);
    let listed = client.capture_photographs(&made.id, CameraConvention::Opengl).await.unwrap().photographs;
    assert_eq!(listed.len(), PHOTOGRAPHS);
    client.capture_photograph(&listed[0], "width=16").await.unwrap();
    let log = client.capture_log(&made.id).await.unwrap();
    assert!(log.contains("Processed file [8/8]"), "{log}");
    assert!(!log.contains(&*server.data_dir().to_string_lossy()), "{log}");

    let again = client.upload_capture_bytes(archive).await.unwrap();
    assert_eq!((again.id, again.state), (made.id.clone(), CaptureState::Ready));
    let other = client.upload_capture_bytes(zip_of(&photographs(8))).await.unwrap();
    assert_ne!(other.id, made.id, "the control: other photographs");
    ended(client, &other.id).await;
}

fn tar_gz(files: &[(String, Vec<u8>)]) -> Vec<u8> {
    let mut tar = tar::Builder::new(flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast()));
    for (name, bytes) in files {
        let mut header = tar::Header::new_gnu();
        header.set_size(bytes.len() as u64);
        header.set_mode(0o644);
        tar.append_data(&mut header, name, bytes.as_slice()).unwrap();
    }
    tar.into_inner().unwrap().finish().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn every_upload_method_accepts_photographs_without_poses() {
    let place = Place::new("3.8", ":", COPY);
    let server = server(&place).await;
    let client = server.client();
    let add = |form: Form, (name, bytes)| form.part("files", Part::bytes(bytes).file_name(name));
    let form = photographs(0).into_iter().fold(Form::new(), add);
    let answer = client.request(Method::POST, "/v1/captures").unwrap().multipart(form).send().await.unwrap();
    assert_eq!(answer.status(), 202);
    let of_form: CaptureSummary = serde_json::from_str(&answer.text().await.unwrap()).unwrap();
    let packed = client.upload_capture_bytes(tar_gz(&photographs(16))).await.unwrap();
    let archive = zip_of(&photographs(8));
    let upload = client.begin_upload(archive.len() as u64).await.unwrap();
    client.send_piece(&upload, 0, archive).await.unwrap();
    let in_pieces = client.capture_of_upload(&upload).await.unwrap();
    for begun in [of_form, packed, in_pieces] {
        let made = ended(client, &begun.id).await;
        assert_eq!(made.state, CaptureState::Ready, "{:?}", made.problem);
    }
    assert!(client.uploads().await.unwrap().items.is_empty(), "they became captures");
}

#[tokio::test(flavor = "multi_thread")]
async fn pose_estimation_reports_its_stage_and_runs_one_at_a_time() {
    let place = Place::new("3.8", WAIT, COPY);
    let server = server(&place).await;
    let client = server.client();
    let first = client.upload_capture_bytes(zip_of(&photographs(0))).await.unwrap();
    let at_work = until(client, &first.id, |capture| stage(capture) == Some(PosesStage::Matching)).await;
    assert_eq!(at_work.poses.unwrap().done, 1.0, "one block of one");
    let second = client.upload_capture_bytes(zip_of(&photographs(8))).await.unwrap();
    until(client, &second.id, |capture| stage(capture) == Some(PosesStage::Waiting)).await;
    let log = client.capture_log(&first.id).await.unwrap();
    assert!(log.contains("Matching block"), "{log}");
    assert_eq!(client.capture_log(&second.id).await.unwrap(), "", "it has said nothing");
    let job = NewJob { capture: first.id.clone(), ..NewJob::default() };
    let refused = client.create_job(&job, None).await.unwrap_err();
    assert_eq!(refused.problem().unwrap().kind, "urn:relume:problem:capture-validating");
    let again = client.upload_capture_bytes(zip_of(&photographs(0))).await.unwrap();
    assert_eq!(again.id, first.id, "the same photographs are worked on once");
    assert_eq!(stage(&client.capture(&second.id).await.unwrap()), Some(PosesStage::Waiting));
    fs::write(place.at("bin/gate"), "").unwrap();
    for id in [&first.id, &second.id] {
        let made = ended(client, id).await;
        assert_eq!((made.state, made.poses), (CaptureState::Ready, None), "{:?}", made.problem);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn deletion_stops_pose_estimation() {
    for of_upload in [false, true] {
        let place = Place::new("3.8", HANG, COPY);
        let server = server(&place).await;
        let client = server.client();
        let begun = client.upload_capture_bytes(zip_of(&photographs(0))).await.unwrap();
        let pid = hanging(&place).await;
        assert!(is_running(&pid), "the control");
        let waiting = client.upload_capture_bytes(zip_of(&photographs(8))).await.unwrap();
        // A waiting capture can also be deleted.
        client.delete_capture(&waiting.id, false).await.unwrap();
        match of_upload {
            false => client.delete_capture(&begun.id, false).await.unwrap(),
            true => client.delete_upload(&begun.upload.clone().unwrap()).await.unwrap(),
        }
        gone(&pid).await;
        assert_eq!(client.capture(&begun.id).await.unwrap_err().problem().unwrap().status, 404);
        left(server.data_dir(), &[]).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn failed_pose_estimation_reports_the_cause_and_keeps_its_log() {
    let too_few = Place::new("3.8", ":", COPY);
    too_few.write_model(3);
    let broken = Place::new("3.8", "echo 'no more memory'; exit 1", COPY);
    let slow = Place::new("3.8", HANG, COPY);
    for (place, code, words) in [
        (&too_few, "too-few-placed", "3 of 8 photographs"),
        (&broken, "program-failed", "no more memory"),
        (&slow, "timed-out", "1 minutes"),
    ] {
        let change = |poses: &mut PosesPolicy| {
            if code == "timed-out" {
                poses.timeout = Duration::from_secs(2);
            }
        };
        let server = server_on(TempDir::new().unwrap(), place, change).await;
        let client = server.client();
        let begun = client.upload_capture_bytes(zip_of(&photographs(0))).await.unwrap();
        let failed = ended(client, &begun.id).await;
        assert_eq!(failed.state, CaptureState::Invalid);
        let (found, detail) = problem_code(&failed);
        assert!(found == code && detail.contains(words), "{found}: {detail}");
        assert!(!detail.contains(&*server.data_dir().to_string_lossy()), "{detail}");
        let log = client.capture_log(&begun.id).await.unwrap();
        assert!(log.contains("Processed file [8/8]"), "{log}");
        // Only the upload and the log remain, until they are deleted.
        let upload = failed.upload.unwrap();
        left(
            server.data_dir(),
            &[format!("artifacts/uploads/{upload}"), format!("poses/{}/colmap.log", begun.id)],
        )
        .await;
        client.delete_capture(&begun.id, false).await.unwrap();
        left(server.data_dir(), &[]).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn without_colmap_photographs_are_refused_with_instructions() {
    let place = Place::new("3.5", ":", COPY);
    let missing = |poses: &mut PosesPolicy| poses.program = place.at("bin/none");
    let off = |poses: &mut PosesPolicy| poses.is_on = false;
    let old = |_: &mut PosesPolicy| {};
    type Change<'a> = &'a dyn Fn(&mut PosesPolicy);
    let changes: [(Change<'_>, &[&str]); 3] = [
        (&missing, &["is not installed", "apt-get install colmap"]),
        (&off, &["--poses off", "relume capture poses"]),
        (&old, &["version 3.5", "at least 3.6"]),
    ];
    for (change, words) in changes {
        let server = server_on(TempDir::new().unwrap(), &place, change).await;
        let refused = server.client().upload_capture_bytes(zip_of(&photographs(0))).await.unwrap_err();
        let problem = refused.problem().unwrap();
        assert_eq!((problem.status, problem.kind.as_str()), (422, "urn:relume:problem:invalid-content"));
        let detail = problem.detail.as_deref().unwrap();
        words.iter().for_each(|word| assert!(detail.contains(word), "{word}: {detail}"));
        left(server.data_dir(), &[]).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn pose_estimation_does_not_start_beyond_the_quota() {
    let place = Place::new("3.8", ":", COPY);
    let archive = zip_of(&photographs(0));
    let program = place.at("bin/colmap");
    let room = archive.len() as u64 * 3 / 2;
    let change = |config: &mut relume::server::ServerConfig| {
        config.poses = PosesPolicy { is_on: true, program, ..PosesPolicy::default() };
        config.quota.bytes = Some(room);
    };
    let server = testing::spawn_with(TempDir::new().unwrap(), change).await.unwrap();
    let client = server.client();
    let begun = client.upload_capture_bytes(archive).await.unwrap();
    let refused = ended(client, &begun.id).await;
    assert_eq!(refused.state, CaptureState::Invalid);
    assert!(refused.problem.as_ref().unwrap().kind.contains("quota"), "{:?}", refused.problem);
    assert!(!server.data_dir().join("poses").exists(), "COLMAP was not started");
}

#[tokio::test(flavor = "multi_thread")]
async fn pose_estimation_resumes_after_a_restart() {
    let place = Place::new("3.8", WAIT, COPY);
    let first = server(&place).await;
    let begun = first.client().upload_capture_bytes(zip_of(&photographs(0))).await.unwrap();
    until(first.client(), &begun.id, |capture| stage(capture) == Some(PosesStage::Matching)).await;
    let data = first.stop().await.unwrap();
    let second = server_on(data, &place, |_| {}).await;
    let found = second.client().capture(&begun.id).await.unwrap();
    assert_eq!(found.state, CaptureState::Validating, "{:?}", found.problem);
    fs::write(place.at("bin/gate"), "").unwrap();
    let made = ended(second.client(), &begun.id).await;
    assert_eq!(made.state, CaptureState::Ready, "{:?}", made.problem);
    left(second.data_dir(), &[format!("artifacts/captures/{}", made.sha256)]).await;
}

#[tokio::test(flavor = "multi_thread")]
#[cfg(target_os = "linux")]
async fn after_kill_9_orphaned_colmap_is_stopped_and_poses_resumed() {
    let place = Place::new("3.8", HANG, COPY);
    let data = TempDir::new().unwrap();
    let start = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_relume"));
        let path = format!("{}:{}", place.at("bin").display(), std::env::var("PATH").unwrap());
        command.env("PATH", path);
        Server::start_under(command, data.path())
    };
    let server = start();
    let begun = server.client.upload_capture_bytes(zip_of(&photographs(0))).await.unwrap();
    let orphan = hanging(&place).await;
    server.kill();
    assert!(is_running(&orphan), "the control: it does not end by itself");
    place.replace("3.8", ":", COPY);
    let server = start();
    let made = ended(&server.client, &begun.id).await;
    assert_eq!(made.state, CaptureState::Ready, "{:?}", made.problem);
    gone(&orphan).await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs COLMAP and RELUME_TEST_DATA (see CONTRIBUTING.md), and minutes"]
async fn colmap_finds_the_poses_of_phone_photographs_over_http() {
    let capture = data("captures/beer71_colmap");
    let mut entries: Vec<_> =
        fs::read_dir(capture.join("images")).unwrap().map(|e| e.unwrap().path()).collect();
    entries.sort();
    let name = |path: &Path| path.file_name().unwrap().to_string_lossy().into_owned();
    let sent: Vec<_> = entries.iter().step_by(3).map(|path| (name(path), fs::read(path).unwrap())).collect();
    let change = |config: &mut relume::server::ServerConfig| config.poses.is_on = true;
    let server = testing::spawn_with(TempDir::new().unwrap(), change).await.unwrap();
    let client = server.client();
    let begun = client.upload_capture_bytes(zip_of(&sent)).await.unwrap();
    let made = loop {
        let capture = client.capture(&begun.id).await.unwrap();
        if capture.state != CaptureState::Validating {
            break capture;
        }
        tokio::time::sleep(Duration::from_millis(500)).await;
    };
    assert_eq!(made.state, CaptureState::Ready, "{:?}", made.problem);
    let listed = client.capture_cameras(&made.id, CameraConvention::Opengl).await.unwrap().cameras;
    assert!(listed.len() + 2 >= sent.len(), "{} of {}", listed.len(), sent.len());
    let bare = |name: &str| name.rsplit('/').next().unwrap().to_owned();
    let stated: std::collections::BTreeMap<_, _> = cameras(&capture, &ImportLimits::default(), UpAxis::Auto)
        .unwrap()
        .into_iter()
        .map(|c| (bare(&c.name), c.camera))
        .collect();
    let camera = |c: &relume_api::cameras::CapturedCamera| c.camera.camera((c.width, c.height)).unwrap();
    let pairs: Vec<_> = listed.iter().map(|c| (camera(c), stated[&bare(&c.name)])).collect();
    let (found, mut truth): (Vec<_>, Vec<_>) = pairs.into_iter().unzip();
    let (rotation, position) = PoseErrors::of(&found, &truth).unwrap().medians();
    assert!(rotation < 1.0 && position < 0.05, "{rotation} degrees, {position}");
    truth.rotate_left(5);
    let control = PoseErrors::of(&found, &truth);
    assert!(
        control.is_none_or(|errors| errors.medians().1 > 0.1),
        "the control: cameras of other photographs"
    );
}
