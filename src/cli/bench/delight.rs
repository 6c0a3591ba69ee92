//! `relume bench delight`: albedo of photographs without their light against the ground truth.

use std::path::PathBuf;

use crate::cli::bench::input::BenchModel;
use crate::cli::bench::table::{head, publish, row};
use crate::cli::error::CommandResult;
use crate::cli::model_capture;
use relume_train::eval::{delit_albedo_scores, figure};

/// Options of `relume bench delight`.
#[derive(Debug, clap::Args)]
pub(super) struct DelightBenchArgs {
    /// A capture whose held-out views have ground-truth albedo.
    #[arg(long)]
    capture: PathBuf,
    /// Models of this capture.
    #[arg(required = true)]
    models: Vec<PathBuf>,
    /// Longest image side, pixels. Default: the stored size.
    #[arg(long, value_parser = clap::value_parser!(u32).range(16..=8192))]
    resolution: Option<u32>,
    /// Held-out views to compare. Default: all.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    views: Option<u32>,
    /// The Markdown file to write. The table is also printed.
    #[arg(long)]
    out: Option<PathBuf>,
}

pub(super) fn run(args: &DelightBenchArgs) -> CommandResult {
    let mut text = head(&["model"], ["albedo of the model, dB", "albedo of the photographs, dB"]);
    for path in &args.models {
        let BenchModel { name, model } = BenchModel::read(path)?;
        let capture = model_capture::read(&args.capture, &model, args.resolution, None)?;
        let scores = delit_albedo_scores(&model, &capture, args.views.map(|views| views as usize))?;
        text += &row([name, figure(scores.map(|s| s.model), 2), figure(scores.map(|s| s.delit), 2)]);
    }
    Ok(publish(&text, args.out.as_deref())?)
}
