//! `relume bench device`: times training steps and frames on one device, per stage, and compares them with the device's limits.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::cli::bench::table::{head, machine, publish, row};
use crate::cli::error::CommandResult;
use relume_capture::{Capture, SyntheticOptions, builtin, synthetic};
use relume_engine::gpu::{DeviceCounts, StageTime};
use relume_engine::{Device, DeviceChoice};
use relume_scene::{Camera, Model};
use relume_spec::rendering::{Output, Quality, Tier};
use relume_spec::training::{Preset, TrainConfig, TrainOverrides};
use relume_train::Trainer;
use relume_train::eval::figure;
use relume_train::render::Renderer;

/// Steps before the measurement, during which pipelines are compiled and buffers grow to their final size.
const WARM_UP: usize = 5;

/// Options of `relume bench device`.
#[derive(Debug, clap::Args)]
pub(super) struct DeviceArgs {
    /// Device: `auto`, `cpu`, `gpu` or `gpu:N`.
    #[arg(long, default_value_t)]
    device: DeviceChoice,
    /// Numbers of Gaussians, separated by commas.
    #[arg(long, value_delimiter = ',', default_value = "50000,200000,1000000")]
    gaussians: Vec<u32>,
    /// Side of the square photographs, pixels.
    #[arg(long, default_value_t = 800, value_parser = clap::value_parser!(u32).range(16..=4096))]
    size: u32,
    /// Number of training steps and frames to measure.
    #[arg(long, default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..))]
    steps: u32,
    /// Samples per pixel of Monte-Carlo frames, which are slow on a software GPU. 0 omits these frames.
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=i64::from(Quality::MAX_SAMPLES)))]
    samples: u32,
    /// Memory bandwidth of the device, GB/s, for the comparison with its limits.
    #[arg(long)]
    bandwidth: Option<f64>,
    /// Arithmetic throughput of the device in f32, TFLOP/s, for the comparison with its limits.
    #[arg(long)]
    tflops: Option<f64>,
    /// The Markdown file to write. The report is also printed.
    #[arg(long)]
    out: Option<PathBuf>,
}

/// The measurements for one number of Gaussians.
struct DeviceMeasurements {
    gaussians: usize,
    step_ms: f64,
    /// The host's work for each step on a GPU.
    host: Option<HostMeasurements>,
    stages: Vec<StageTime>,
    /// Tier with frame size, and frames per second.
    frames: Vec<(String, f64)>,
    peak_bytes: Option<u64>,
}

/// The host's average work per step.
struct HostMeasurements {
    /// Recording of commands and the training schedule.
    recording_ms: f64,
    /// Submission of commands. A software driver executes them during this time.
    submitting_ms: f64,
    dispatches: f64,
    submissions: f64,
    waits: f64,
}

impl HostMeasurements {
    fn of(counts: DeviceCounts, elapsed: Duration, steps: u32) -> Self {
        let a_step = |total: f64| total / f64::from(steps);
        Self {
            recording_ms: a_step(
                elapsed.saturating_sub(counts.waited + counts.submitting).as_secs_f64() * 1e3,
            ),
            submitting_ms: a_step(counts.submitting.as_secs_f64() * 1e3),
            dispatches: a_step(counts.dispatches as f64),
            submissions: a_step(counts.submissions as f64),
            waits: a_step(counts.waits as f64),
        }
    }
}

pub(super) fn run(args: &DeviceArgs) -> CommandResult {
    let device = Device::open(args.device)?;
    eprintln!("device: {}", device.name());
    let capture = synthetic(&SyntheticOptions {
        train_views: 4,
        test_views: 1,
        size: args.size,
        paths: 4,
        relit: Default::default(),
        ..SyntheticOptions::default()
    })?;
    let mut all = Vec::new();
    for &n in &args.gaussians {
        eprintln!("{n} Gaussians");
        all.push(measure(args, &device, &capture, n)?);
    }
    Ok(publish(&report(args, &device, &all), args.out.as_deref())?)
}

fn measure(
    args: &DeviceArgs,
    device: &Device,
    capture: &Capture,
    n: u32,
) -> CommandResult<DeviceMeasurements> {
    let overrides = TrainOverrides {
        resolution: Some(args.size),
        initial_gaussians: Some(n),
        max_gaussians: Some(n),
        // Every step has all loss terms, and density control is inactive.
        warm_up: Some(0.0),
        half_resolution: Some(0.0),
        iterations: Some(1_000_000),
        ..TrainOverrides::default()
    };
    let config = TrainConfig::new(Preset::High, &overrides)?;
    let mut trainer = Trainer::new(capture, config, device)?;
    for _ in 0..WARM_UP {
        trainer.step()?;
    }
    let counts = || match device {
        Device::Cpu => None,
        Device::Gpu(gpu) => Some(gpu.counts()),
    };
    let (before, start) = (counts(), Instant::now());
    for _ in 0..args.steps {
        trainer.step()?;
    }
    let elapsed = start.elapsed();
    let spent = counts().zip(before).map(|(now, before)| now - before);
    let host = spent.map(|spent| HostMeasurements::of(spent, elapsed, args.steps));
    let step_ms = elapsed.as_secs_f64() * 1e3 / f64::from(args.steps);
    let mut stages = Vec::new();
    if let Device::Gpu(gpu) = device {
        gpu.measure(true);
        for _ in 0..args.steps {
            trainer.step()?;
        }
        stages = gpu.timings();
        gpu.measure(false);
        let per_step = 1.0 / f64::from(args.steps);
        for s in &mut stages {
            (s.ms, s.bytes, s.flops) = (s.ms * per_step, s.bytes * per_step, s.flops * per_step);
        }
    }
    let model = trainer.model()?;
    drop(trainer);
    let gaussians = model.gaussians.len();
    let frames = frames(args, device, capture, model)?;
    let peak_bytes = match device {
        Device::Cpu => None,
        Device::Gpu(gpu) => Some(gpu.memory().1),
    };
    Ok(DeviceMeasurements { gaussians, step_ms, host, stages, frames, peak_bytes })
}

fn frames(
    args: &DeviceArgs,
    device: &Device,
    capture: &Capture,
    model: Model,
) -> CommandResult<Vec<(String, f64)>> {
    let renderer = Renderer::on(Arc::new(model), device)?;
    // A light with a dominant light that is separated and casts a shadow.
    let light = builtin("sunset").map_or_else(|| renderer.model().recovered_light(), Into::into);
    let light = renderer.prepare_light(light)?;
    let mut qualities: Vec<Quality> = [Tier::Preview, Tier::Standard, Tier::High].map(Quality::from).to_vec();
    qualities.extend((args.samples > 0).then(|| Quality::monte_carlo(args.samples)));
    let mut out = Vec::new();
    let square = &capture.test[0].camera;
    for (width, height) in [(args.size, args.size), (args.size * 12 / 5, args.size * 27 / 20)] {
        let camera = framed(square, width, height);
        for &quality in &qualities {
            let samples = if quality.tier == Tier::MonteCarlo { quality.samples } else { 1 };
            let frames = (args.steps / samples).max(1);
            renderer.render(&camera, &light, quality, &[Output::Rgb])?;
            let start = Instant::now();
            for _ in 0..frames {
                renderer.render(&camera, &light, quality, &[Output::Rgb])?;
            }
            let rate = f64::from(frames) / start.elapsed().as_secs_f64();
            let of = if samples > 1 { format!(", {samples} samples,") } else { String::new() };
            out.push((format!("{}{of} {width}x{height}", quality.tier.name()), rate));
        }
    }
    Ok(out)
}

/// A camera with the same vertical field of view and another size.
fn framed(camera: &Camera, width: u32, height: u32) -> Camera {
    let focal = camera.fy * f64::from(height) / f64::from(camera.height);
    Camera {
        width,
        height,
        fx: focal,
        fy: focal,
        cx: 0.5 * f64::from(width),
        cy: 0.5 * f64::from(height),
        ..*camera
    }
}

fn report(args: &DeviceArgs, device: &Device, all: &[DeviceMeasurements]) -> String {
    let columns = all.iter().map(|f| format!("{} Gaussians", f.gaussians));
    let mut text = format!(
        "{}; seed 0.\nPhotographs {1}x{1}, preset `high`, every step with all terms.\n\n{2}",
        machine(device),
        args.size,
        head(&["per step"], columns)
    );
    let mut line = |name: &str, cell: &dyn Fn(&DeviceMeasurements) -> String| {
        text += &row(std::iter::once(name.to_owned()).chain(all.iter().map(cell)));
    };
    line("whole step, ms", &|f| format!("{:.2}", f.step_ms));
    if all.iter().all(|f| f.host.is_some()) {
        let of = |f: &DeviceMeasurements, value: &dyn Fn(&HostMeasurements) -> f64| {
            figure(f.host.as_ref().map(value), 2)
        };
        line("stages together, ms", &|f| format!("{:.2}", f.stages.iter().map(|s| s.ms).sum::<f64>()));
        line("recording on the host, ms", &|f| of(f, &|h| h.recording_ms));
        line("submitting, ms", &|f| of(f, &|h| h.submitting_ms));
        line("dispatches", &|f| of(f, &|h| h.dispatches));
        line("submissions", &|f| of(f, &|h| h.submissions));
        line("waits", &|f| of(f, &|h| h.waits));
    }
    for stage in all.first().map_or(&[][..], |f| &f.stages) {
        let ms =
            |f: &DeviceMeasurements| f.stages.iter().find(|s| s.name == stage.name).map_or(0.0, |s| s.ms);
        line(&format!("{}, ms", stage.name), &|f| format!("{:.3}", ms(f)));
    }
    for (k, (name, _)) in all.first().map_or(&[][..], |f| &f.frames).iter().enumerate() {
        line(&format!("{name}, frames/s"), &|f| format!("{:.1}", f.frames[k].1));
    }
    line("peak device memory so far, MB", &|f| figure(f.peak_bytes.map(|b| b as f64 / 1e6), 0));
    text + &limits(args, all)
}

/// Compares the three most expensive counted stages with the device's limits, if these are given.
fn limits(args: &DeviceArgs, all: &[DeviceMeasurements]) -> String {
    let (Some(bandwidth), Some(tflops)) = (args.bandwidth, args.tflops) else { return String::new() };
    let mut text = format!(
        "\nAgainst {bandwidth} GB/s and {tflops} TFLOP/s (minimum bytes and operations, as counted):\n\n{}",
        head(&["stage"], ["Gaussians", "ms", "MB", "GFLOP", "limit, ms", "of the limit"])
    );
    for figures in all {
        let mut counted: Vec<&StageTime> = figures.stages.iter().filter(|s| s.bytes > 0.0).collect();
        counted.sort_by(|a, b| b.ms.total_cmp(&a.ms));
        for s in counted.iter().take(3) {
            let limit = (s.bytes / bandwidth / 1e6).max(s.flops / tflops / 1e9);
            text += &row([
                s.name.to_string(),
                figures.gaussians.to_string(),
                format!("{:.3}", s.ms),
                format!("{:.1}", s.bytes / 1e6),
                format!("{:.2}", s.flops / 1e9),
                format!("{limit:.3}"),
                format!("{:.0} %", 100.0 * limit / s.ms.max(1e-9)),
            ]);
        }
    }
    text
}
