//! `relume bench confidence`: how well the confidence of models predicts their errors.

use std::path::PathBuf;

use crate::cli::bench::input::{BenchModel, read_capture};
use crate::cli::bench::table::{head, publish, row};
use crate::cli::error::CommandResult;
use relume_train::eval::{ConfidenceScore, confidence_scores, figure};

/// Options of `relume bench confidence`.
#[derive(Debug, clap::Args)]
pub(super) struct ConfidenceArgs {
    /// A capture with ground-truth relit pictures and layers.
    #[arg(long)]
    capture: PathBuf,
    /// Models of this capture.
    #[arg(required = true)]
    models: Vec<PathBuf>,
    /// Longest image side, pixels.
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u32).range(16..=8192))]
    resolution: u32,
    /// Held-out views to compare.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    views: u32,
    /// The Markdown file to write. The table is also printed.
    #[arg(long)]
    out: Option<PathBuf>,
}

pub(super) fn run(args: &ConfidenceArgs) -> CommandResult {
    let capture = read_capture(&args.capture, args.resolution)?;
    let columns = ["rank correlation", "AUSE", "AUSE of a random order"];
    let mut text = head(&["model", "error"], columns.map(str::to_owned).to_vec());
    for path in &args.models {
        let BenchModel { name, model } = BenchModel::read(path)?;
        if model.gaussians.confidence().is_none() {
            return Err(format!(
                "{}: the model has no confidence; only models that this version trained have it",
                path.display()
            )
            .into());
        }
        let scores = confidence_scores(&model, &capture, Some(args.views as usize))?;
        for (layer, score) in [("relit", scores.relit), ("albedo", scores.albedo), ("normal", scores.normal)]
        {
            let of = |pick: fn(&ConfidenceScore) -> f64| figure(score.as_ref().map(pick), 2);
            let cells = [of(|s| s.rank_correlation), of(|s| s.ause), of(|s| s.ause_random)];
            text += &row([name.clone(), layer.to_owned()].into_iter().chain(cells));
        }
    }
    Ok(publish(&text, args.out.as_deref())?)
}
