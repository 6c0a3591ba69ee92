//! `relume eval`: a model file against a capture's ground truth.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use indicatif::{ProgressBar, ProgressStyle};

use crate::capture::{Capture, CaptureError, ImportOptions, import};
pub use crate::cli::args::QualityArgs;
use crate::cli::output;
use crate::engine::Device;
use crate::engine::{DeviceChoice, DeviceError};
use crate::eval::{EvalError, EvalOptions, Lpips, LpipsError, contact_sheet, evaluate};
use crate::formats::model_file::{self, ModelFileError};

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

/// Why `relume eval` gave no report. Each names the file at fault.
#[derive(Debug, thiserror::Error)]
pub enum EvalCommandError {
    /// A file could not be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file could not be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Not a model.
    #[error("{path}: {source}")]
    Model {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: ModelFileError,
    },
    /// The capture cannot be imported.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// The LPIPS weights were refused.
    #[error(transparent)]
    Lpips(#[from] LpipsError),
    /// The device cannot be had.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// Nothing could be compared.
    #[error(transparent)]
    Eval(#[from] EvalError),
    /// The contact sheet could not be encoded.
    #[error("contact sheet: {0}")]
    Sheet(#[from] image::ImageError),
}

/// Evaluates, prints the Markdown report and writes what was asked for.
///
/// # Errors
/// [`EvalCommandError`] names the file at fault. Output folders are made before the work begins.
pub fn run(args: &EvalArgs) -> Result<(), EvalCommandError> {
    [&args.json, &args.markdown, &args.sheet].into_iter().flatten().try_for_each(|f| make_folder(f))?;
    let bytes = read(&args.model)?;
    let model = model_file::decode(&bytes)
        .map_err(|source| EvalCommandError::Model { path: args.model.clone(), source })?;
    let model = Arc::new(model);
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
        quality: args.quality.quality(),
        ..EvalOptions::default()
    };
    let report = evaluate(model.clone(), &capture, &options)?;
    bar.finish_and_clear();

    let markdown = report.to_markdown();
    println!("{markdown}");
    if let Some(path) = &args.json {
        write(path, report.to_json().as_bytes())?;
    }
    if let Some(path) = &args.markdown {
        write(path, markdown.as_bytes())?;
    }
    if let Some(path) = &args.sheet {
        let sheet = contact_sheet(model, &capture, args.quality.quality(), SHEET_ROWS, &device)?;
        write(path, &sheet.to_png(CELL)?)?;
    }
    Ok(())
}

fn load_capture(args: &EvalArgs) -> Result<Capture, EvalCommandError> {
    let options = ImportOptions { max_side: args.resolution, ..ImportOptions::default() };
    let capture = import(&args.capture, &options)?;
    capture.warnings.iter().for_each(|warning| eprintln!("warning: {warning}"));
    Ok(capture)
}

fn progress_bar() -> ProgressBar {
    let style = ProgressStyle::with_template("{spinner} comparing views {pos}/{len} {wide_bar} {eta}");
    ProgressBar::new(0).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

fn read(path: &Path) -> Result<Vec<u8>, EvalCommandError> {
    std::fs::read(path).map_err(|source| EvalCommandError::Read { path: path.to_owned(), source })
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), EvalCommandError> {
    output::write_whole(path, bytes)
        .map_err(|source| EvalCommandError::Write { path: path.to_owned(), source })
}

/// A report that cannot be written should be known before it is measured.
fn make_folder(file: &Path) -> Result<(), EvalCommandError> {
    let Some(folder) = file.parent().filter(|p| !p.as_os_str().is_empty()) else { return Ok(()) };
    std::fs::create_dir_all(folder)
        .map_err(|source| EvalCommandError::Write { path: file.to_owned(), source })
}
