//! `relume eval`: compares a model file with a capture's ground truth.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use indicatif::{ProgressBar, ProgressStyle};

pub use crate::cli::args::QualityArgs;
use crate::cli::error::CommandResult;
use crate::cli::light::read_rotations;
use crate::cli::{input, output};
use relume_capture::{Capture, ImportOptions, import};
use relume_engine::Device;
use relume_engine::DeviceChoice;
use relume_train::eval::{EvalOptions, Lpips, contact_sheet, evaluate};

/// Side of a contact sheet's cells, pixels.
const CELL: u32 = 200;
/// Views on a contact sheet.
const SHEET_ROWS: usize = 4;

/// Measure a model against a capture's held-out views and ground truth.
#[derive(Debug, clap::Args)]
pub struct EvalArgs {
    /// The model file.
    pub model: PathBuf,
    /// The capture: a folder or an archive, with held-out views.
    #[arg(long, value_name = "DIR")]
    pub capture: PathBuf,
    /// Write the report as JSON.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Write the report as Markdown; it is printed in any case.
    #[arg(long, value_name = "FILE")]
    pub markdown: Option<PathBuf>,
    /// Write a contact sheet as PNG.
    #[arg(long, value_name = "FILE")]
    pub sheet: Option<PathBuf>,
    /// LPIPS v0.1 AlexNet weights (safetensors); without them LPIPS is left out and the report says so.
    #[arg(long, value_name = "WEIGHTS", env = "RELUME_LPIPS_WEIGHTS")]
    pub lpips: Option<PathBuf>,
    /// Longest side in pixels to compare at; the stored size when absent.
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(16..=8192))]
    pub resolution: Option<u32>,
    /// Turns of the light in single photographs, as given to `train`.
    #[arg(long, value_name = "FILE")]
    pub light_rotations: Option<PathBuf>,
    /// Where to render: `auto`, `cpu`, `gpu` or `gpu:N`.
    #[arg(long, default_value_t)]
    pub device: DeviceChoice,
    /// The tier to compare.
    #[command(flatten)]
    pub quality: QualityArgs,
    /// Compare only this many held-out views, evenly spaced.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub views: Option<u32>,
}

/// Evaluates, prints the Markdown report and writes what was asked for.
///
/// # Errors
/// Names the file at fault. Output folders are made before the work begins.
pub fn run(args: &EvalArgs) -> CommandResult {
    [&args.json, &args.markdown, &args.sheet].into_iter().flatten().try_for_each(|f| make_folder(f))?;
    let model = Arc::new(input::read_model(&args.model)?);
    let lpips = args.lpips.as_deref().map(Lpips::read).transpose()?;
    let capture = load_capture(args)?;

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
    let report = evaluate(model.clone(), &capture, &options)?;
    bar.finish_and_clear();

    let markdown = report.to_markdown();
    println!("{markdown}");
    if let Some(path) = &args.json {
        output::write_named(path, report.to_json().as_bytes())?;
    }
    if let Some(path) = &args.markdown {
        output::write_named(path, markdown.as_bytes())?;
    }
    if let Some(path) = &args.sheet {
        let sheet =
            contact_sheet(model, &capture, args.quality.quality(EvalOptions::TIER), SHEET_ROWS, &device)?;
        output::write_named(path, &sheet.to_png(CELL)?)?;
    }
    Ok(())
}

fn load_capture(args: &EvalArgs) -> CommandResult<Capture> {
    let options = ImportOptions { max_side: args.resolution, ..ImportOptions::default() };
    let mut capture = import(&args.capture, &options)?;
    if let Some(file) = &args.light_rotations {
        capture.set_light_rotations(&read_rotations(file)?)?;
    }
    capture.warnings.iter().for_each(|warning| eprintln!("warning: {warning}"));
    Ok(capture)
}

fn progress_bar() -> ProgressBar {
    let style = ProgressStyle::with_template("{spinner} comparing views {pos}/{len} {wide_bar} {eta}");
    ProgressBar::new(0).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

/// Makes the folder of an output before the work begins, so that a wrong path is known early.
fn make_folder(file: &Path) -> Result<(), String> {
    let Some(folder) = file.parent().filter(|p| !p.as_os_str().is_empty()) else { return Ok(()) };
    std::fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", file.display()))
}
