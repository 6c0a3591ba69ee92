//! `relume export`: a model file in, a PLY of Gaussians out.

use std::path::PathBuf;

use crate::cli::error::CommandResult;
use crate::cli::{input, output};
use crate::formats::ply_model;

/// Options of `relume export`.
#[derive(Debug, clap::Args)]
pub(super) struct ExportArgs {
    /// The model file.
    model: PathBuf,
    /// The file to write, ending in `.ply`.
    #[arg(long, default_value = "model.ply")]
    out: PathBuf,
}

pub(super) fn run(args: &ExportArgs) -> CommandResult {
    if args.out.extension().is_none_or(|e| !e.eq_ignore_ascii_case("ply")) {
        return Err(format!("{}: only .ply can be written", args.out.display()).into());
    }
    let model = input::read_model(&args.model)?;
    output::write_named(&args.out, &ply_model::encode(&model))?;
    eprintln!("wrote {}", args.out.display());
    Ok(())
}
