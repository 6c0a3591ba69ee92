//! The fixture of the measurement: a small model that the service trained, its capture, and an upload of large photographs.

use std::io::{Cursor, Write};

use image::codecs::jpeg::JpegEncoder;
use serde_json::json;
use tokio_util::bytes::Bytes;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use crate::cli::bench::service::args::ServiceArgs;
use crate::cli::error::CommandResult;
use relume_api::jobs::{JobState, NewJob};
use relume_api::{CaptureId, ModelId};
use relume_capture::{SyntheticOptions, synthetic, write_archive};
use relume_client::Client;
use relume_spec::training::{Preset, TrainOverrides};

/// Side of the photographs for the training, pixels.
const SIDE: u32 = 64;

/// A model in the service, and the settings of its training.
pub(super) struct Fixture {
    pub(super) client: Client,
    pub(super) capture: CaptureId,
    pub(super) model: ModelId,
    gaussians: u32,
}

impl Fixture {
    /// Uploads the synthetic capture and trains on it.
    pub(super) async fn train(client: Client, args: &ServiceArgs) -> CommandResult<Self> {
        let options =
            SyntheticOptions { size: SIDE, train_views: 12, test_views: 2, paths: 16, ..Default::default() };
        let drawn = move || synthetic(&options).and_then(|capture| write_archive(&capture));
        let archive = tokio::task::spawn_blocking(drawn).await??;
        let capture = client.upload_capture_bytes(archive).await?.id;
        let job = client.create_job(&job(&capture, args.iterations, args.gaussians), None).await?;
        let job = client.wait(&job.id, |_| {}).await?;
        let model = job.model.filter(|_| job.state == JobState::Succeeded);
        let model = model.ok_or_else(|| format!("the training of the model ended {}", job.state.name()))?;
        Ok(Self { client, capture, model, gaussians: args.gaussians })
    }

    /// A training with the settings of the model and `iterations` steps.
    pub(super) fn job(&self, iterations: u32) -> NewJob {
        job(&self.capture, iterations, self.gaussians)
    }
}

fn job(capture: &CaptureId, iterations: u32, gaussians: u32) -> NewJob {
    let overrides = TrainOverrides {
        iterations: Some(iterations),
        resolution: Some(SIDE),
        max_gaussians: Some(gaussians),
        ..TrainOverrides::default()
    };
    NewJob { capture: capture.clone(), preset: Preset::Draft, overrides, ..NewJob::default() }
}

/// A capture with `count` copies of one JPEG of `megapixels` megapixels, 4 : 3. Blocks.
pub(super) fn photographs(count: u32, megapixels: f64) -> CommandResult<Bytes> {
    let height = (megapixels * 1e6 * 0.75).sqrt().round().max(3.0) as u32;
    let (width, jpeg) = (height * 4 / 3, photograph(height * 4 / 3, height)?);
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let stored = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    let mut frames = Vec::new();
    for i in 0..count {
        let name = format!("images/{i:03}.jpg");
        archive.start_file(name.as_str(), stored)?;
        archive.write_all(&jpeg)?;
        frames.push(json!({ "file_path": name, "transform_matrix": pose(i, count) }));
    }
    let lens = 1.2 * f64::from(width);
    let transforms = json!({ "fl_x": lens, "fl_y": lens, "w": width, "h": height, "frames": frames });
    archive.start_file("transforms.json", stored)?;
    archive.write_all(transforms.to_string().as_bytes())?;
    Ok(archive.finish()?.into_inner().into())
}

/// A camera-to-world matrix on a circle, facing its centre.
fn pose(i: u32, count: u32) -> [[f64; 4]; 4] {
    let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / f64::from(count)).sin_cos();
    [[-sin, 0.0, cos, 3.0 * cos], [cos, 0.0, sin, 3.0 * sin], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
}

/// An image with detail everywhere, so that decoding takes as long as for a photograph.
fn photograph(width: u32, height: u32) -> CommandResult<Vec<u8>> {
    let mut state = 1_u32;
    let picture = image::RgbImage::from_fn(width, height, |x, y| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let noise = (state >> 27) as u8;
        image::Rgb([(x / 16) as u8, (y / 16) as u8, ((x + y) / 32) as u8].map(|c| (c / 2 + 48) + noise))
    });
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, 90).encode_image(&picture)?;
    Ok(bytes)
}
