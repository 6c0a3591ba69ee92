//! Shared code of the tests of the service: small valid inputs that are generated.

use std::io::{Cursor, Write};
use std::path::Path;
use std::time::Duration;

use glam::DVec3;
use relume::store::Store;
use relume::testing::{database_name, database_of};
use relume_api::jobs::{JobState, JobView, NewJob};
use relume_api::keys::Scope;
use relume_api::{CaptureId, JobId};
use relume_capture::formats::image_file::encode_png;
use relume_client::Client;
use relume_scene::Camera;
use relume_spec::training::Preset;
use serde_json::{Value, json};
use sqlx::AnyPool;

/// Whether the service's tests run on PostgreSQL (`.ci/postgres`) in place of SQLite.
pub fn on_postgres() -> bool {
    std::env::var_os("RELUME_TEST_POSTGRES").is_some()
}

/// The store of a data directory on which no server runs.
pub async fn open_store(data: &Path) -> Store {
    Store::open_with(data, database_of(data).await.unwrap().as_ref()).await.unwrap()
}

/// Direct access to the database of a data directory, for checks and for damage. Statements use `$1`; results
/// are numbers and text.
pub async fn raw_pool(data: &Path) -> AnyPool {
    sqlx::any::install_default_drivers();
    let url = match std::env::var("RELUME_TEST_POSTGRES") {
        Ok(server) => {
            database_of(data).await.unwrap();
            let (server, _) = server.rsplit_once('/').unwrap();
            format!("{server}/{}", database_name(data))
        }
        Err(_) => format!("sqlite://{}", data.join("relume.db").display()),
    };
    AnyPool::connect(&url).await.unwrap()
}

/// Every scope that is permitted for keys of tenants other than the operator's.
pub const ALL_OF_A_TENANT: [Scope; 5] =
    [Scope::Read, Scope::Render, Scope::Submit, Scope::Admin, Scope::Priority];

/// A capture archive under construction: NeRF-synthetic, a ball on a transparent background.
pub struct CaptureZip {
    pub transforms: Value,
    pub images: Vec<(String, Vec<u8>)>,
}

impl CaptureZip {
    /// `count` photographs of `size` x `size` pixels, all around the ball.
    pub fn new(count: usize, size: u32) -> Self {
        let mut frames = Vec::new();
        let mut images = Vec::new();
        for i in 0..count {
            let angle = i as f64 / count as f64 * std::f64::consts::TAU;
            let eye = DVec3::new(3.0 * angle.cos(), 3.0 * angle.sin(), 1.0);
            let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.7, (size, size)).unwrap();
            let matrix = camera.to_opengl().transpose().to_cols_array_2d();
            frames.push(json!({ "file_path": format!("./train/r_{i}"), "transform_matrix": matrix }));
            images.push((format!("train/r_{i}.png"), photograph(&camera)));
        }
        Self { transforms: json!({ "camera_angle_x": 0.7, "frames": frames }), images }
    }

    /// The archive's bytes.
    pub fn zip(&self) -> Vec<u8> {
        let transforms = serde_json::to_vec(&self.transforms).unwrap();
        let mut entries = vec![("transforms_train.json".to_owned(), transforms)];
        entries.extend(self.images.iter().cloned());
        zip_of(&entries)
    }
}

/// A zip of named entries.
pub fn zip_of(entries: &[(String, Vec<u8>)]) -> Vec<u8> {
    let mut writer = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in entries {
        writer.start_file(name.as_str(), zip::write::SimpleFileOptions::default()).unwrap();
        writer.write_all(bytes).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

/// A small valid capture.
pub fn capture_zip() -> Vec<u8> {
    CaptureZip::new(8, 32).zip()
}

/// A ball of radius 0.8, lit from above, straight alpha.
fn photograph(camera: &Camera) -> Vec<u8> {
    let pixel = |x, y| {
        let (o, d) = (camera.centre(), camera.ray(x, y));
        let b = o.dot(d);
        let disc = b * b - (o.length_squared() - 0.64);
        if disc < 0.0 {
            return [0, 0, 0, 0];
        }
        let n = (o + d * (-b - disc.sqrt())) / 0.8;
        let light = 60.0 + 150.0 * (0.5 + 0.5 * n.z);
        [light as u8, (light * 0.6) as u8, (light * 0.4 * (1.0 + 0.5 * n.x)) as u8, 255]
    };
    let pixels: Vec<[u8; 4]> = (0..camera.height)
        .flat_map(|y| (0..camera.width).map(move |x| (x, y)))
        .map(|(x, y)| pixel(x, y))
        .collect();
    encode_png(camera.width, camera.height, &pixels).unwrap()
}

/// A job of `iterations` steps at 32 pixels with a checkpoint every `every`.
pub fn small_job(capture: &CaptureId, iterations: u32, every: u32) -> NewJob {
    let mut job = NewJob { capture: capture.clone(), preset: Preset::Draft, ..NewJob::default() };
    job.overrides.iterations = Some(iterations);
    job.overrides.resolution = Some(32);
    job.overrides.max_gaussians = Some(64);
    job.overrides.checkpoint_every = Some(every);
    job
}

/// Polls a job until it satisfies `done`.
pub async fn until(client: &Client, id: &JobId, done: impl Fn(&JobView) -> bool) -> JobView {
    for _ in 0..3000 {
        let job = client.job(id).await.unwrap();
        if done(&job) {
            return job;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    panic!("job {id} never got there");
}

/// Polls a job until it ends.
pub async fn ended(client: &Client, id: &JobId) -> JobView {
    until(client, id, |job| job.state.is_terminal()).await
}

/// Trains a small model and returns its job.
pub async fn trained(client: &Client) -> JobView {
    let capture = client.upload_capture_bytes(capture_zip()).await.unwrap();
    let job = client.create_job(&small_job(&capture.id, 10, 5), None).await.unwrap();
    let job = ended(client, &job.id).await;
    assert_eq!(job.state, JobState::Succeeded, "{:?}", job.error);
    job
}

/// Every file under a folder, by relative path, with its size, without the files of the database and the
/// lock.
pub fn files_under(root: &std::path::Path) -> Vec<(String, u64)> {
    let mut found = Vec::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        // A file that a running server removes in between is skipped.
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            let path = entry.path();
            let name = path.strip_prefix(root).unwrap().display().to_string();
            if path.is_dir() {
                folders.push(path);
            } else if !name.starts_with("relume.db") && name != "node.lock" {
                found.extend(entry.metadata().map(|m| (name, m.len())));
            }
        }
    }
    found.sort();
    found
}
