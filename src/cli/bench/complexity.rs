//! `relume bench complexity`: compares trainings with all model features and with the features that the scene requires.

use std::path::PathBuf;

use crate::cli::args::{name_of, named, overrides};
use crate::cli::bench::input::{file_name, read_capture};
use crate::cli::bench::table::{head, machine, publish, row};
use crate::cli::bench::training::{Trained, train_and_evaluate};
use crate::cli::error::CommandResult;
use crate::cli::explain::findings;
use crate::cli::light::illuminate;
use relume_capture::formats::model_file;
use relume_capture::{Capture, SyntheticOptions, SyntheticScene, synthetic};
use relume_engine::{Device, DeviceChoice};
use relume_spec::training::{Complexity, Preset, TrainConfig};
use relume_train::eval::Report;

/// The synthetic scenes, with their names in the table.
const SCENES: [(&str, SyntheticScene); 4] = [
    ("matte ball", SyntheticScene::MatteBall),
    ("mirror ball", SyntheticScene::MirrorBall),
    ("one material", SyntheticScene::OneMaterial),
    ("table", SyntheticScene::Table),
];

/// Options of `relume bench complexity`.
#[derive(Debug, clap::Args)]
pub(super) struct ComplexityArgs {
    /// Captures to train on, in addition to the synthetic scenes.
    captures: Vec<PathBuf>,
    /// Preset: `draft`, `standard` or `high`.
    #[arg(long, default_value = "draft", value_parser = named::<Preset>)]
    preset: Preset,
    /// Longest image side, pixels.
    #[arg(long, default_value_t = 64)]
    resolution: u32,
    /// Optimisation steps.
    #[arg(long, default_value_t = 800)]
    iterations: u32,
    /// Maximum number of Gaussians. A training starts with half of it.
    #[arg(long, default_value_t = 3000)]
    gaussians: u32,
    /// Seed of all random choices.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Any other override of the preset; repeatable. `auto` does not change a setting that is given here.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Held-out views to compare.
    #[arg(long, default_value_t = 6)]
    views: usize,
    /// Only the synthetic scenes with these names, separated by commas, or `none`.
    #[arg(long, value_delimiter = ',')]
    only: Vec<String>,
    /// Device: `auto`, `cpu`, `gpu` or `gpu:N`.
    #[arg(long, default_value_t)]
    device: DeviceChoice,
    /// The Markdown file to write. The report is also printed.
    #[arg(long)]
    out: Option<PathBuf>,
}

/// The columns after the scene's name.
const COLUMNS: [&str; 10] = [
    "floats a Gaussian",
    "Gaussians",
    "file, kB",
    "smaller",
    "training, s",
    "faster",
    "novel view, dB",
    "relit mean, dB",
    "relit mean, albedo aligned, dB",
    "albedo scale",
];

pub(super) fn run(args: &ComplexityArgs) -> CommandResult {
    let device = Device::open(args.device)?;
    let mut text = format!(
        "{}; seed {}.\nPreset {}, {} steps, {} px, at most {} Gaussians; each cell: full, then auto.\n\n{}",
        machine(&device),
        args.seed,
        name_of(args.preset),
        args.iterations,
        args.resolution,
        args.gaussians,
        head(&["scene"], COLUMNS)
    );
    for (name, scene) in SCENES {
        if args.only.is_empty() || args.only.iter().any(|n| n == name) {
            let options =
                SyntheticOptions { scene, size: args.resolution, seed: args.seed, ..Default::default() };
            text += &compare(args, &device, name, synthetic(&options)?)?;
        }
    }
    for path in &args.captures {
        text += &compare(args, &device, &file_name(path), read_capture(path, args.resolution)?)?;
    }
    Ok(publish(&text, args.out.as_deref())?)
}

/// Compares the trainings on one capture. Returns the table row.
fn compare(
    args: &ComplexityArgs,
    device: &Device,
    name: &str,
    mut capture: Capture,
) -> CommandResult<String> {
    illuminate(&mut capture, &config(args, Complexity::Full)?)?;
    let train = |complexity| train_and_evaluate(&capture, config(args, complexity)?, device, args.views);
    let (full, auto) = (train(Complexity::Full)?, train(Complexity::Auto)?);
    for finding in findings(&auto.model.card) {
        eprintln!("{name}: {finding}");
    }
    let both = |show: fn(&Trained) -> String| format!("{}, {}", show(&full), show(&auto));
    let psnr = |pick: fn(&Report) -> Option<f64>| match (pick(&full.report), pick(&auto.report)) {
        (Some(a), Some(b)) => format!("{a:.2}, {b:.2} ({:+.2})", b - a),
        _ => "-".to_owned(),
    };
    let size = |t: &Trained| model_file::encode(&t.model).map(|bytes| bytes.len());
    let (full_bytes, auto_bytes) = (size(&full)?, size(&auto)?);
    let line = row([
        name.to_owned(),
        both(|t| model_file::floats_a_gaussian(&t.model).to_string()),
        both(|t| t.model.gaussians.len().to_string()),
        format!("{}, {}", full_bytes / 1000, auto_bytes / 1000),
        format!("{:.2}x", full_bytes as f64 / auto_bytes as f64),
        both(|t| format!("{:.1}", t.seconds)),
        format!("{:.2}x", full.seconds / auto.seconds),
        psnr(|r| r.novel_view.psnr),
        psnr(|r| r.relit.mean.psnr),
        psnr(|r| r.relit_aligned.mean.psnr),
        scales(&full.report, &auto.report),
    ]);
    eprint!("{line}");
    Ok(line)
}

/// The ratio of true to recovered albedo per channel, for both trainings.
fn scales(full: &Report, auto: &Report) -> String {
    let each = |report: &Report| report.albedo.scale.map(|[r, g, b]| format!("{r:.2} {g:.2} {b:.2}"));
    match (each(full), each(auto)) {
        (Some(full), Some(auto)) => format!("{full}; {auto}"),
        _ => "-".to_owned(),
    }
}

fn config(args: &ComplexityArgs, complexity: Complexity) -> CommandResult<TrainConfig> {
    let flags = [
        ("resolution", Some(args.resolution.into())),
        ("iterations", Some(args.iterations.into())),
        ("seed", Some(args.seed.into())),
    ];
    let mut config = TrainConfig::new(args.preset, &overrides(&flags, &args.set)?)?;
    // This is not an override: an override would force the number, but `auto` must decide it.
    config.max_gaussians = args.gaussians;
    config.initial_gaussians = (args.gaussians / 2).max(16);
    config.complexity = complexity;
    Ok(config)
}
