//! `relume bench complexity`: each scene trained with everything and with what it requires, side by side.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use crate::capture::{Capture, ImportOptions, SyntheticOptions, SyntheticScene, import, synthetic};
use crate::cli::args::{named, overrides};
use crate::cli::light::illuminate;
use crate::cli::{CommandResult, output};
use crate::engine::Device;
use crate::engine::DeviceChoice;
use crate::eval::{EvalOptions, Report, evaluate};
use crate::formats::model_file;
use crate::train::{Complexity, Preset, TrainConfig, Trainer};

type Failure = Box<dyn std::error::Error + Send + Sync>;

/// The synthetic scenes, by the name they have in the table.
const SCENES: [(&str, SyntheticScene); 4] = [
    ("matte ball", SyntheticScene::MatteBall),
    ("mirror ball", SyntheticScene::MirrorBall),
    ("one material", SyntheticScene::OneMaterial),
    ("table", SyntheticScene::Table),
];

/// Options of `relume bench complexity`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Captures to train on besides the synthetic scenes.
    captures: Vec<PathBuf>,
    /// `draft`, `standard` or `high`.
    #[arg(long, default_value = "draft", value_parser = named::<Preset>)]
    preset: Preset,
    /// Longest image side, pixels.
    #[arg(long, default_value_t = 64)]
    resolution: u32,
    /// Optimisation steps.
    #[arg(long, default_value_t = 800)]
    iterations: u32,
    /// Most Gaussians; half as many at the start.
    #[arg(long, default_value_t = 3000)]
    gaussians: u32,
    /// Seed of every random choice.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Any other override of the preset; what is named here is not decided on.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Held-out views compared.
    #[arg(long, default_value_t = 6)]
    views: usize,
    /// Only the synthetic scenes with these names, or `none`.
    #[arg(long, value_delimiter = ',')]
    only: Vec<String>,
    /// Where to compute: `auto`, `cpu`, `gpu` or `gpu:N`.
    #[arg(long, default_value_t)]
    device: DeviceChoice,
    /// The Markdown file to write; printed in any case.
    #[arg(long)]
    out: Option<PathBuf>,
}

/// What one training came to.
struct Outcome {
    floats: usize,
    gaussians: usize,
    bytes: usize,
    seconds: f64,
    report: Report,
    findings: Vec<String>,
}

pub(super) fn run(args: &Args) -> CommandResult {
    let device = Device::open(args.device)?;
    let mut text = head(args, &device)?;
    for (name, scene) in SCENES {
        if args.only.is_empty() || args.only.iter().any(|n| n == name) {
            let options =
                SyntheticOptions { scene, size: args.resolution, seed: args.seed, ..Default::default() };
            row(args, &device, name, synthetic(&options)?, &mut text)?;
        }
    }
    for path in &args.captures {
        let options =
            ImportOptions { max_side: Some(args.resolution), load_truth: true, ..ImportOptions::default() };
        let name = path.file_name().map_or_else(|| path.display().to_string(), |n| n.display().to_string());
        row(args, &device, &name, import(path, &options)?, &mut text)?;
    }
    println!("{text}");
    if let Some(path) = &args.out {
        output::write_named(path, text.as_bytes())?;
    }
    Ok(())
}

fn head(args: &Args, device: &Device) -> Result<String, std::fmt::Error> {
    let mut text = String::new();
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    writeln!(text, "Device: {}; host with {threads} threads; seed {}.", device.name(), args.seed)?;
    writeln!(
        text,
        "Preset {:?}, {} steps, {} px, at most {} Gaussians; each cell: full, then auto.\n",
        args.preset, args.iterations, args.resolution, args.gaussians
    )?;
    writeln!(
        text,
        "| scene | floats a Gaussian | Gaussians | file, kB | smaller | training, s | faster | novel view, dB | relit mean, dB | relit mean, albedo aligned, dB | albedo scale |"
    )?;
    writeln!(text, "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|")?;
    Ok(text)
}

fn row(
    args: &Args,
    device: &Device,
    name: &str,
    mut capture: Capture,
    text: &mut String,
) -> Result<(), Failure> {
    illuminate(&mut capture, &config(args, Complexity::Full)?)?;
    let full = train(args, device, &capture, Complexity::Full)?;
    let auto = train(args, device, &capture, Complexity::Auto)?;
    for finding in &auto.findings {
        eprintln!("{name}: {finding}");
    }
    let pair = |a: Option<f64>, b: Option<f64>| match (a, b) {
        (Some(a), Some(b)) => format!("{a:.2}, {b:.2} ({:+.2})", b - a),
        _ => "-".to_owned(),
    };
    let line = format!(
        "| {name} | {}, {} | {}, {} | {}, {} | {:.2}x | {:.1}, {:.1} | {:.2}x | {} | {} | {} | {} |",
        full.floats,
        auto.floats,
        full.gaussians,
        auto.gaussians,
        full.bytes / 1000,
        auto.bytes / 1000,
        full.bytes as f64 / auto.bytes as f64,
        full.seconds,
        auto.seconds,
        full.seconds / auto.seconds,
        pair(full.report.novel_view.psnr, auto.report.novel_view.psnr),
        pair(full.report.relit.mean.psnr, auto.report.relit.mean.psnr),
        pair(full.report.relit_aligned.mean.psnr, auto.report.relit_aligned.mean.psnr),
        scales(&full.report, &auto.report),
    );
    eprintln!("{line}");
    writeln!(text, "{line}")?;
    Ok(())
}

/// What the true albedo is of ours, by channel: where it moves, so does raw relighting.
fn scales(full: &Report, auto: &Report) -> String {
    let each = |report: &Report| report.albedo.scale.map(|[r, g, b]| format!("{r:.2} {g:.2} {b:.2}"));
    match (each(full), each(auto)) {
        (Some(full), Some(auto)) => format!("{full}; {auto}"),
        _ => "-".to_owned(),
    }
}

fn config(args: &Args, how: Complexity) -> Result<TrainConfig, Failure> {
    let flags = [
        ("resolution", Some(args.resolution.into())),
        ("iterations", Some(args.iterations.into())),
        ("seed", Some(args.seed.into())),
    ];
    let mut config = TrainConfig::new(args.preset, &overrides(&flags, &args.set)?)?;
    // Set here and not as an override: that would force the number, and it is one of the things to decide.
    config.max_gaussians = args.gaussians;
    config.initial_gaussians = (args.gaussians / 2).max(16);
    config.complexity = how;
    Ok(config)
}

fn train(args: &Args, device: &Device, capture: &Capture, how: Complexity) -> Result<Outcome, Failure> {
    let mut trainer = Trainer::new(capture, config(args, how)?, device)?;
    while !trainer.is_done() {
        trainer.step()?;
    }
    let (model, seconds) = (trainer.model()?, trainer.seconds());
    drop(trainer);
    let bytes = model_file::encode(&model)?.len();
    let (floats, gaussians) = (model_file::floats_a_gaussian(&model), model.gaussians.len());
    let findings = crate::cli::explain::findings(&model.card);
    let options = EvalOptions {
        views: Some(args.views),
        frame_rate_time: Duration::ZERO,
        device,
        ..EvalOptions::default()
    };
    let report = evaluate(Arc::new(model), capture, &options)?;
    Ok(Outcome { floats, gaussians, bytes, seconds, report, findings })
}
