//! `relume bench device`: a real training and real frames on one device, stage by stage, against the device's limits.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use crate::capture::{Capture, SyntheticOptions, synthetic};
use crate::cli::{CommandResult, output};
use crate::engine::Device;
use crate::engine::DeviceChoice;
use crate::engine::gpu::StageTime;
use crate::render::{Output, Renderer, Tier};
use crate::scene::{Camera, Model};
use crate::train::{Preset, TrainConfig, TrainOverrides, Trainer};

type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Steps before anything is measured: pipelines are compiled, buffers have their size.
const WARM_UP: usize = 5;

/// Options of `relume bench device`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Where to compute: `auto`, `cpu`, `gpu` or `gpu:N`.
    #[arg(long, default_value_t)]
    device: DeviceChoice,
    /// Numbers of Gaussians.
    #[arg(long, value_delimiter = ',', default_value = "50000,200000,1000000")]
    gaussians: Vec<u32>,
    /// Side of the square photographs, pixels.
    #[arg(long, default_value_t = 800, value_parser = clap::value_parser!(u32).range(16..=4096))]
    size: u32,
    /// Training steps and frames measured.
    #[arg(long, default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..))]
    steps: u32,
    /// Memory bandwidth of the device, GB/s, to compare with.
    #[arg(long)]
    bandwidth: Option<f64>,
    /// Arithmetic of the device in f32, TFLOP/s, to compare with.
    #[arg(long)]
    tflops: Option<f64>,
    /// The Markdown file to write; printed in any case.
    #[arg(long)]
    out: Option<PathBuf>,
}

/// What one number of Gaussians came to.
struct Figures {
    gaussians: usize,
    step_ms: f64,
    stages: Vec<StageTime>,
    /// Frames a second: what, rate.
    frames: Vec<(String, f64)>,
    peak_bytes: Option<u64>,
}

pub(super) fn run(args: &Args) -> CommandResult {
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
    let text = report(args, &device, &all)?;
    println!("{text}");
    if let Some(path) = &args.out {
        output::write_named(path, text.as_bytes())?;
    }
    Ok(())
}

fn measure(args: &Args, device: &Device, capture: &Capture, n: u32) -> Result<Figures, Failure> {
    let overrides = TrainOverrides {
        resolution: Some(args.size),
        initial_gaussians: Some(n),
        max_gaussians: Some(n),
        // Every step is a full one, and density control stays out of the way.
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
    let start = Instant::now();
    for _ in 0..args.steps {
        trainer.step()?;
    }
    let step_ms = start.elapsed().as_secs_f64() * 1e3 / f64::from(args.steps);
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
    Ok(Figures { gaussians, step_ms, stages, frames, peak_bytes })
}

fn frames(
    args: &Args,
    device: &Device,
    capture: &Capture,
    model: Model,
) -> Result<Vec<(String, f64)>, Failure> {
    let renderer = Renderer::on(Arc::new(model), device)?;
    let light = renderer.prepare_light(&renderer.model().environment())?;
    let mut out = Vec::new();
    let square = &capture.test[0].camera;
    for (width, height) in [(args.size, args.size), (args.size * 12 / 5, args.size * 27 / 20)] {
        let camera = framed(square, width, height);
        for tier in [Tier::Preview, Tier::Standard] {
            renderer.render(&camera, &light, tier, &[Output::Rgb])?;
            let start = Instant::now();
            for _ in 0..args.steps {
                renderer.render(&camera, &light, tier, &[Output::Rgb])?;
            }
            let rate = f64::from(args.steps) / start.elapsed().as_secs_f64();
            out.push((format!("{} {width}x{height}", tier.name()), rate));
        }
    }
    Ok(out)
}

/// The same view in another format, as high as before.
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

fn report(args: &Args, device: &Device, all: &[Figures]) -> Result<String, std::fmt::Error> {
    let mut text = String::new();
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    writeln!(text, "Device: {}; host with {threads} threads; seed 0.", device.name())?;
    writeln!(text, "Photographs {0}x{0}, preset `high`, every step with all terms.\n", args.size)?;
    let head: Vec<String> = all.iter().map(|f| format!("{} Gaussians", f.gaussians)).collect();
    writeln!(text, "| per step | {} |", head.join(" | "))?;
    writeln!(text, "|---|{}", "---:|".repeat(all.len()))?;
    let mut row = |name: &str, cells: Vec<String>| writeln!(text, "| {name} | {} |", cells.join(" | "));
    row("whole step, ms", all.iter().map(|f| format!("{:.2}", f.step_ms)).collect())?;
    for stage in all.first().map_or(&[][..], |f| &f.stages) {
        let ms = |f: &Figures| f.stages.iter().find(|s| s.name == stage.name).map_or(0.0, |s| s.ms);
        row(&format!("{}, ms", stage.name), all.iter().map(|f| format!("{:.3}", ms(f))).collect())?;
    }
    for (k, (name, _)) in all.first().map_or(&[][..], |f| &f.frames).iter().enumerate() {
        row(&format!("{name}, frames/s"), all.iter().map(|f| format!("{:.0}", f.frames[k].1)).collect())?;
    }
    let memory = |f: &Figures| f.peak_bytes.map_or("-".to_owned(), |b| format!("{:.0}", b as f64 / 1e6));
    row("peak device memory so far, MB", all.iter().map(memory).collect())?;
    limits(args, all, &mut text)?;
    Ok(text)
}

/// The three costliest counted stages against the device's limits.
fn limits(args: &Args, all: &[Figures], text: &mut String) -> std::fmt::Result {
    let (Some(bandwidth), Some(tflops)) = (args.bandwidth, args.tflops) else { return Ok(()) };
    writeln!(
        text,
        "\nAgainst {bandwidth} GB/s and {tflops} TFLOP/s (least bytes and operations, as counted):\n"
    )?;
    writeln!(text, "| stage | Gaussians | ms | MB | GFLOP | limit, ms | of the limit |")?;
    writeln!(text, "|---|---:|---:|---:|---:|---:|---:|")?;
    for figures in all {
        let mut counted: Vec<&StageTime> = figures.stages.iter().filter(|s| s.bytes > 0.0).collect();
        counted.sort_by(|a, b| b.ms.total_cmp(&a.ms));
        for s in counted.iter().take(3) {
            let limit = (s.bytes / bandwidth / 1e6).max(s.flops / tflops / 1e9);
            writeln!(
                text,
                "| {} | {} | {:.3} | {:.1} | {:.2} | {limit:.3} | {:.0} % |",
                s.name,
                figures.gaussians,
                s.ms,
                s.bytes / 1e6,
                s.flops / 1e9,
                100.0 * limit / s.ms.max(1e-9)
            )?;
        }
    }
    Ok(())
}
