//! A complete workflow over HTTP: starts a server, uploads a capture, trains, relights and downloads.
//! An integration test can do the same.
//!
//! ```sh
//! cargo run --release --example relight_over_http
//! ```

use std::path::Path;

use relume_api::cameras::{CameraSpec, LookAtSpec};
use relume_api::jobs::NewJob;
use relume_api::renders::{EnvironmentSpec, RenderRequest};
use relume_capture::{SyntheticOptions, synthetic, write_archive};
use relume_spec::rendering::{FrameFormat, Output};
use relume_spec::training::{Preset, TrainOverrides};

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Starts a server on a free port with a temporary store. For another server use `Client::new(url, key)`.
    let server = relume::testing::spawn().await?;
    let client = server.client();

    let options =
        SyntheticOptions { train_views: 12, test_views: 2, size: 64, paths: 16, ..Default::default() };
    let capture = client.upload_capture_bytes(write_archive(&synthetic(&options)?)?).await?;
    println!("capture {}: {} photographs", capture.id, capture.report.train_images);

    let job = NewJob {
        capture: capture.id,
        preset: Preset::Draft,
        overrides: TrainOverrides { iterations: Some(300), resolution: Some(64), ..Default::default() },
        ..NewJob::default()
    };
    let job = client.create_job(&job, Some("example-1")).await?;
    let job = client.wait(&job.id, |event| println!("{:>10} {}", event.kind, event.data)).await?;
    let model = job.model.ok_or("the job did not succeed")?;

    let look_at =
        LookAtSpec { eye: [3.0, -1.5, 1.5], target: [0.0; 3], up: [0.0, 0.0, 1.0], fov_y_deg: 40.0 };
    for light in ["studio", "sunset", "night"] {
        let request = RenderRequest {
            camera: CameraSpec { look_at: Some(look_at.clone()), ..CameraSpec::default() },
            environment: EnvironmentSpec { builtin: Some(light.to_owned()), ..EnvironmentSpec::default() },
            width: 256,
            height: 256,
            outputs: vec![Output::Rgb],
            ..RenderRequest::default()
        };
        let file = format!("relit_{light}.png");
        std::fs::write(&file, client.render(&model, &request, FrameFormat::Png).await?)?;
        println!("wrote {file}");
    }
    client.download(&model, "model.ply", Path::new("relit_model.ply")).await?;
    println!("wrote relit_model.ply");
    server.stop().await?;
    Ok(())
}
