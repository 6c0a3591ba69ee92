//! `relume eval`: compares a model with the ground truth of a capture.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use indicatif::{ProgressBar, ProgressStyle};

pub use crate::cli::args::QualityArgs;
use crate::cli::error::CommandResult;
use crate::cli::sheet::{sheet_format, write_sheet};
use crate::cli::{input, model_capture, output};
use relume_capture::ImportLimits;
use relume_engine::{Device, DeviceChoice};
use relume_train::eval::{CaptureFacts, EvalOptions, Lpips, SheetRows, contact_sheet, evaluate};
use relume_train::{colour_matrix_of_card, up_of_card};

/// Compare a model with the held-out views and the ground truth of a capture.
#[derive(Debug, clap::Args)]
pub struct EvalArgs {
    /// The model file.
    pub model: PathBuf,
    /// The capture with held-out views: a folder or an archive.
    #[arg(long, value_name = "DIR")]
    pub capture: PathBuf,
    /// Write the report as JSON to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Write the report as Markdown to this file. The report is also printed.
    #[arg(long, value_name = "FILE")]
    pub markdown: Option<PathBuf>,
    /// Write a contact sheet to this file, `.png` or `.jpg`: photographs, renders, relit pictures, all layers and the error,
    /// above their ground truth if the capture has it.
    #[arg(long, value_name = "FILE")]
    pub sheet: Option<PathBuf>,
    /// LPIPS v0.1 AlexNet weights (safetensors). Without them, LPIPS is omitted and the report states this.
    #[arg(long, value_name = "WEIGHTS", env = "RELUME_LPIPS_WEIGHTS")]
    pub lpips: Option<PathBuf>,
    /// Longest side for the comparison, pixels. Default: the stored size.
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(16..=8192))]
    pub resolution: Option<u32>,
    /// Rotations of the light in single photographs, as for `train`.
    #[arg(long = "light-rotation-file", alias = "light-rotations", value_name = "FILE")]
    pub light_rotations: Option<PathBuf>,
    /// Device: `auto`, `cpu`, `gpu` or `gpu:N`.
    #[arg(long, default_value_t)]
    pub device: DeviceChoice,
    /// The tier to compare.
    #[command(flatten)]
    pub quality: QualityArgs,
    /// Number of held-out views to compare, evenly spaced. Default: all.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub views: Option<u32>,
}

/// Evaluates, prints the Markdown report and writes the requested files.
///
/// # Errors
/// The error names the affected file. The folders of the output files are created before the evaluation.
pub fn run(args: &EvalArgs) -> CommandResult {
    [&args.json, &args.markdown, &args.sheet].into_iter().flatten().try_for_each(|f| make_folder(f))?;
    args.sheet.as_deref().map(sheet_format).transpose()?;
    let model = Arc::new(input::read_model(&args.model)?);
    let lpips = args.lpips.as_deref().map(Lpips::read).transpose()?;
    let (up, colours) = (up_of_card(&model.card)?, colour_matrix_of_card(&model.card)?);
    let capture =
        model_capture::read(&args.capture, &model, args.resolution, args.light_rotations.as_deref())?;

    let bar = progress_bar();
    let progress = |done: usize, total: usize| {
        bar.set_length(total as u64);
        bar.set_position(done as u64);
    };
    let device = Device::open(args.device)?;
    let options = EvalOptions {
        device: &device,
        lpips: lpips.as_ref(),
        views: args.views.map(|n| n as usize),
        progress: &progress,
        quality: args.quality.quality(EvalOptions::TIER),
        ..EvalOptions::default()
    };
    let mut report = evaluate(model.clone(), &capture, &options)?;
    bar.finish_and_clear();
    report.summary = CaptureFacts::of(&capture).summary(&report, &model.card);

    let markdown = report.to_markdown();
    println!("{markdown}");
    if let Some(path) = &args.json {
        output::write_named(path, report.to_json().as_bytes())?;
    }
    if let Some(path) = &args.markdown {
        output::write_named(path, markdown.as_bytes())?;
    }
    if let Some(path) = &args.sheet {
        let mut rows = SheetRows::choose(&capture, Some(&report));
        rows.read_again(&args.capture, up, colours, &ImportLimits::default())?;
        let mut sheet = contact_sheet(model, &rows, options.quality, &device)?;
        report.summary.iter().for_each(|line| sheet.add_heading(line));
        write_sheet(path, &sheet)?;
    }
    Ok(())
}

fn progress_bar() -> ProgressBar {
    let style = ProgressStyle::with_template("{spinner} comparing views {pos}/{len} {wide_bar} {eta}");
    ProgressBar::new(0).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

/// Creates the folder of an output file before the evaluation, so that an invalid path fails early.
fn make_folder(file: &Path) -> Result<(), String> {
    let Some(folder) = file.parent().filter(|p| !p.as_os_str().is_empty()) else { return Ok(()) };
    std::fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", file.display()))
}
