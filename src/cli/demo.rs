//! `relume demo`: runs the whole service on a scene with known ground truth, in one command and within a few minutes.
//!
//! The demo starts a server and does what a user would do over HTTP: upload, train, render, download. Only the evaluation and its
//! contact sheet are made locally, because the server does not have the ground truth.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use crate::cli::output;
use crate::server::ServeError;
use crate::testing;
use relume_api::cameras::{CameraConvention, CameraSpec};
use relume_api::jobs::NewJob;
use relume_api::renders::{EnvironmentSpec, RenderRequest};
use relume_api::{CaptureId, EnvironmentId, ModelId};
use relume_capture::formats::environment::{self, EnvironmentFileError};
use relume_capture::formats::model_file::{self, ModelFileError};
use relume_capture::{Capture, CaptureError, CaptureView, SyntheticOptions, synthetic, write_archive};
use relume_client::{Client, ClientError, JobEvent};
use relume_spec::rendering::{FrameFormat, Output};
use relume_spec::training::{Preset, TrainOverrides};
use relume_train::eval::{
    CaptureFacts, EvalError, EvalOptions, Report, Sheet, SheetFormat, SheetRows, contact_sheet, evaluate,
};

/// Width and height of the relit pictures, pixels.
const SIZE: u32 = 512;

/// Demonstrate Relume: train on a synthetic capture, relight the model, and compare the result with the exact ground truth.
#[derive(Debug, Clone, clap::Args)]
pub struct DemoArgs {
    /// The folder for the contact sheet, the report and the model. It is created if it does not exist.
    #[arg(long, value_name = "DIR", default_value = "demo-out")]
    pub out: PathBuf,
    /// Seed of the noise in the scene and of the training.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Training steps. Default: the number of the draft preset.
    #[arg(long, value_name = "N")]
    pub iterations: Option<u32>,
}

/// Why the demo failed.
#[derive(Debug, thiserror::Error)]
pub enum DemoError {
    /// A file or folder could not be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The synthetic capture could not be made.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// The server failed to start or stop.
    #[error(transparent)]
    Serve(#[from] ServeError),
    /// A request failed.
    #[error(transparent)]
    Client(#[from] ClientError),
    /// The training failed.
    #[error("the job ended {state}: {detail}")]
    Job {
        /// The last state of the job.
        state: &'static str,
        /// The reason.
        detail: String,
    },
    /// A light could not be encoded.
    #[error(transparent)]
    Light(#[from] EnvironmentFileError),
    /// The contact sheet could not be encoded.
    #[error("contact sheet: {0}")]
    Sheet(#[from] image::ImageError),
    /// The server did not send a valid model.
    #[error(transparent)]
    Model(#[from] ModelFileError),
    /// The evaluation of the model failed.
    #[error(transparent)]
    Eval(#[from] EvalError),
    /// A computation panicked.
    #[error("a computation panicked: {0}")]
    Join(#[from] tokio::task::JoinError),
}

/// Runs the demo and prints its steps and results.
///
/// # Errors
/// [`DemoError`] names the failed step.
pub fn run(args: &DemoArgs) -> Result<(), DemoError> {
    let begin = Instant::now();
    let runtime = tokio::runtime::Runtime::new().map_err(ServeError::from)?;
    let report = runtime.block_on(demo(args))?;
    summary(&report, &args.out, begin.elapsed());
    Ok(())
}

/// Runs the whole demo, from the ground truth to the report. Prints each step when it begins.
///
/// # Errors
/// [`DemoError`] names the failed step.
pub async fn demo(args: &DemoArgs) -> Result<Report, DemoError> {
    let failed = |source| DemoError::Write { path: args.out.clone(), source };
    std::fs::create_dir_all(&args.out).map_err(failed)?;

    println!("1/5 rendering a synthetic capture with exact ground truth");
    let options = SyntheticOptions { seed: args.seed, ..SyntheticOptions::default() };
    let (capture, archive) = tokio::task::spawn_blocking(move || -> Result<_, CaptureError> {
        let capture = synthetic(&options)?;
        let archive = write_archive(&capture)?;
        Ok((Arc::new(capture), archive))
    })
    .await??;

    let server = testing::spawn().await?;
    println!("2/5 uploading {} kB to {}", archive.len() / 1024, server.client().base());
    let uploaded = server.client().upload_capture_bytes(archive).await?;
    let report = show(server.client(), &uploaded.id, capture, args).await;
    // The server is stopped in all cases; the first error is returned.
    let stopped = server.stop().await;
    let report = report?;
    stopped?;
    Ok(report)
}

/// All steps between upload and summary.
async fn show(
    client: &Client,
    capture_id: &CaptureId,
    capture: Arc<Capture>,
    args: &DemoArgs,
) -> Result<Report, DemoError> {
    let (model, training_seconds) = train(client, capture_id, args).await?;
    println!("4/5 relighting a held-out view under {}", listed(&capture));
    for (name, picture) in relit_pictures(client, &model, &capture).await? {
        write(&args.out.join(format!("relit_{name}.png")), &picture)?;
    }

    println!("5/5 comparing with the ground truth, every held-out view under every light");
    let bytes = client.file(&model, "model.safetensors").await?;
    write(&args.out.join("model.safetensors"), &bytes)?;
    let (mut report, sheet) = tokio::task::spawn_blocking(move || measure(&bytes, &capture)).await??;
    write(&args.out.join("contact_sheet.png"), &sheet.encode(SheetFormat::Png)?)?;
    report.note_training_seconds(training_seconds);
    write(&args.out.join("report.json"), report.to_json().as_bytes())?;
    write(&args.out.join("report.md"), report.to_markdown().as_bytes())?;
    Ok(report)
}

/// Queues the training and follows it. Returns the model's identifier and the duration of the job, seconds.
async fn train(
    client: &Client,
    capture: &CaptureId,
    args: &DemoArgs,
) -> Result<(ModelId, Option<f64>), DemoError> {
    let overrides =
        TrainOverrides { seed: Some(args.seed), iterations: args.iterations, ..TrainOverrides::default() };
    let job = NewJob { capture: capture.clone(), preset: Preset::Draft, overrides, ..NewJob::default() };
    let job = client.create_job(&job, None).await?;
    println!("3/5 training, job {}", job.id);
    let bar = progress_bar();
    let job = client.wait(&job.id, |event| show_event(&bar, event)).await?;
    bar.finish();
    let failed = || DemoError::Job {
        state: job.state.name(),
        detail: job.error.as_ref().map_or_else(|| "the job has no model".to_owned(), |e| e.detail.clone()),
    };
    Ok((job.model.clone().ok_or_else(failed)?, seconds_between(&job.started_at, &job.finished_at)))
}

/// Seconds between two RFC 3339 times, if both are given.
fn seconds_between(from: &Option<String>, to: &Option<String>) -> Option<f64> {
    let parse = |time: &Option<String>| time.as_ref()?.parse::<jiff::Timestamp>().ok();
    Some(parse(to)?.duration_since(parse(from)?).as_secs_f64())
}

fn progress_bar() -> ProgressBar {
    let style = ProgressStyle::with_template("    {bar:32} {pos}/{len} {msg} {eta}");
    ProgressBar::new(0).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

fn show_event(bar: &ProgressBar, event: &JobEvent) {
    let number = |name: &str| event.data.get(name).and_then(serde_json::Value::as_f64);
    match event.kind.as_str() {
        "progress" => {
            bar.set_length(number("total").unwrap_or_default() as u64);
            bar.set_position(number("step").unwrap_or_default() as u64);
            let (loss, psnr) = (number("loss").unwrap_or_default(), number("psnr").unwrap_or_default());
            let gaussians = number("gaussians").unwrap_or_default();
            bar.set_message(format!("loss {loss:.4}  PSNR {psnr:.2} dB  {gaussians} Gaussians"));
        }
        "warning" => bar.println(format!("    warning: {}", event.data)),
        _ => {}
    }
}

/// The first held-out view under each light of the ground truth, from the render endpoint, as PNG with the light's name.
async fn relit_pictures(
    client: &Client,
    model: &ModelId,
    capture: &Capture,
) -> Result<Vec<(String, Vec<u8>)>, DemoError> {
    let mut pictures = Vec::new();
    for (name, light) in upload_lights(client, capture).await? {
        if let Some(view) = capture.test.first() {
            pictures.push((name.to_owned(), picture(client, model, view, light).await?));
        }
    }
    Ok(pictures)
}

/// Uploads the lights of the ground truth as environments. Returns name and identifier of each.
async fn upload_lights<'a>(
    client: &Client,
    capture: &'a Capture,
) -> Result<Vec<(&'a str, EnvironmentId)>, DemoError> {
    let mut lights = Vec::new();
    for (name, map) in &capture.lights {
        let uploaded = client.upload_environment(environment::encode_exr(map)?).await?;
        lights.push((name.as_str(), uploaded.id));
    }
    Ok(lights)
}

/// A view under a light from the render endpoint, as PNG.
async fn picture(
    client: &Client,
    model: &ModelId,
    view: &CaptureView,
    light: EnvironmentId,
) -> Result<Vec<u8>, DemoError> {
    let request = RenderRequest {
        camera: CameraSpec::of(&view.camera.resized(SIZE, SIZE), CameraConvention::Opengl),
        environment: EnvironmentSpec { id: Some(light), ..EnvironmentSpec::default() },
        width: SIZE,
        height: SIZE,
        outputs: vec![Output::Rgb],
        ..RenderRequest::default()
    };
    Ok(client.render(model, &request, FrameFormat::Png).await?.to_vec())
}

/// The report on a model, and its contact sheet.
fn measure(model: &[u8], capture: &Capture) -> Result<(Report, Sheet), DemoError> {
    let model = Arc::new(model_file::decode(model)?);
    let options = EvalOptions::default();
    let mut report = evaluate(model.clone(), capture, &options)?;
    report.summary = CaptureFacts::of(capture).summary(&report, &model.card);
    let rows = SheetRows::choose(capture, Some(&report));
    let mut sheet = contact_sheet(model, &rows, options.quality, options.device)?;
    report.summary.iter().for_each(|line| sheet.add_heading(line));
    Ok((report, sheet))
}

fn summary(report: &Report, out: &Path, took: Duration) {
    let figure = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |v| format!("{v:.2}"));
    println!();
    for (light, scores) in &report.relit.lights {
        println!("relit under {light:<10} {} dB", figure(scores.psnr));
    }
    println!(
        "relit, mean            {} dB over {} held-out views",
        figure(report.relit.mean.psnr),
        report.views
    );
    println!("novel views            {} dB", figure(report.novel_view.psnr));
    println!("albedo, aligned        {} dB", figure(report.albedo.psnr_aligned));
    println!("normals                {} degrees off", figure(report.normal_mae_deg.foreground));
    println!("{} Gaussians, {:.0} s in total", report.gaussians, took.as_secs_f64());
    report.summary.iter().for_each(|line| println!("{line}"));
    println!();
    for (file, what) in [
        ("contact_sheet.png", "photographs, renders and layers above the ground truth"),
        ("relit_*.png", "a view under each light, from the server"),
        ("report.md", "all figures and how they were measured"),
        ("report.json", "the report as JSON"),
        ("model.safetensors", "the model"),
    ] {
        println!("{}  {what}", out.join(file).display());
    }
}

fn listed(capture: &Capture) -> String {
    capture.lights.keys().map(String::as_str).collect::<Vec<_>>().join(", ")
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), DemoError> {
    output::write_whole(path, bytes).map_err(|source| DemoError::Write { path: path.to_owned(), source })
}
