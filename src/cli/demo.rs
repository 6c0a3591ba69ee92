//! `relume demo`: runs the whole service on a scene with known ground truth, in one command and within a few minutes.
//!
//! The demo starts a server and does what a user would do over HTTP: upload, train, render, download. Only the evaluation runs
//! locally, because the server does not have the ground truth.

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
use relume_train::eval::sheet::Sheet;
use relume_train::eval::{DisplayImage, EvalError, EvalOptions, Report, evaluate, photograph, truth_layers};

/// Test views on the contact sheet, with two rows each.
const SHEET_VIEWS: usize = 3;
/// Side of a cell of the contact sheet, pixels.
const CELL: u32 = 160;

/// Demonstrate Relume: train on a synthetic capture, relight it and compare the result with the exact ground truth.
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
    /// The server did not send a valid image.
    #[error("rendered picture: {0}")]
    Picture(#[from] image::ImageError),
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
    println!("4/5 relighting held-out views under {}", listed(&capture));
    let sheet = contact_sheet(client, &model, &capture).await?;
    write(&args.out.join("contact_sheet.png"), &sheet.to_png(CELL)?)?;

    println!("5/5 comparing with the ground truth, every held-out view under every light");
    let bytes = client.file(&model, "model.safetensors").await?;
    write(&args.out.join("model.safetensors"), &bytes)?;
    let mut report = tokio::task::spawn_blocking(move || measure(&bytes, &capture)).await??;
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

/// Two rows per view: the render of the service, and the ground truth.
async fn contact_sheet(client: &Client, model: &ModelId, capture: &Capture) -> Result<Sheet, DemoError> {
    let lights = upload_lights(client, capture).await?;
    let mut columns = vec!["input".to_owned()];
    columns.extend(lights.iter().map(|(name, _)| format!("relit {name}")));
    columns.extend(["albedo", "normal", "roughness", "ao"].map(str::to_owned));
    let mut sheet = Sheet::new(columns);
    let step = capture.test.len().div_ceil(SHEET_VIEWS).max(1);
    for view in capture.test.iter().step_by(step) {
        let mut rendered = vec![Some(frame(client, model, view, Output::Rgb, None).await?)];
        for (_, id) in &lights {
            rendered.push(Some(frame(client, model, view, Output::Rgb, Some(id)).await?));
        }
        rendered.push(Some(frame(client, model, view, Output::Albedo, None).await?));
        let coverage = frame(client, model, view, Output::Alpha, None).await?;
        for output in [Output::Normal, Output::Roughness, Output::Visibility] {
            let layer = frame(client, model, view, output, None).await?;
            rendered.push(Some(cut_out(&layer, &coverage)));
        }
        let mut truth = vec![Some(photograph(&view.image.decoded()))];
        truth.extend(lights.iter().map(|(name, _)| view.truth.relit.get(*name).map(photograph)));
        truth.extend(truth_layers(view));
        sheet.push(format!("{}: recovered by Relume", view.name), rendered);
        sheet.push(format!("{}: ground truth", view.name), truth);
    }
    Ok(sheet)
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

/// One output of one view from the render endpoint, on white. The light is the recovered light unless one is given.
async fn frame(
    client: &Client,
    model: &ModelId,
    view: &CaptureView,
    output: Output,
    light: Option<&EnvironmentId>,
) -> Result<DisplayImage, DemoError> {
    let camera = &view.camera;
    let request = RenderRequest {
        camera: CameraSpec::of(camera, CameraConvention::Opengl),
        environment: EnvironmentSpec { id: light.cloned(), ..EnvironmentSpec::default() },
        width: camera.width,
        height: camera.height,
        outputs: vec![output],
        ..RenderRequest::default()
    };
    let png = client.render(model, &request, FrameFormat::Png).await?;
    let image = image::load_from_memory(&png)?.into_rgba32f();
    let on_white = |p: &image::Rgba<f32>| {
        let [r, g, b, a] = p.0;
        [r, g, b].map(|v| v * a + 1.0 - a)
    };
    let values = image.pixels().map(on_white).collect();
    Ok(DisplayImage { width: image.width(), height: image.height(), values })
}

/// A layer without its own alpha, composited on white by the coverage of the frame.
fn cut_out(layer: &DisplayImage, coverage: &DisplayImage) -> DisplayImage {
    let pixel = |(c, a): (&[f32; 3], &[f32; 3])| std::array::from_fn(|k| c[k] * a[k] + 1.0 - a[k]);
    DisplayImage { values: layer.values.iter().zip(&coverage.values).map(pixel).collect(), ..*layer }
}

fn measure(model: &[u8], capture: &Capture) -> Result<Report, DemoError> {
    let model = Arc::new(model_file::decode(model)?);
    Ok(evaluate(model, capture, &EvalOptions::default())?)
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
    println!();
    for (file, what) in [
        ("contact_sheet.png", "photographs, renders and layers side by side"),
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
