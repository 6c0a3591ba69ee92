//! `relume bench attribution`: where the error of relit pictures comes from.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::Arc;

use crate::capture::{ImportOptions, import};
use crate::cli::{CommandResult, output};
use crate::eval::{Replaced, attribute};
use crate::formats::model_file;

/// Options of `relume bench attribution`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// A capture with relit truth and layers.
    #[arg(long)]
    capture: PathBuf,
    /// Models of it.
    #[arg(required = true)]
    models: Vec<PathBuf>,
    /// Longest image side, pixels.
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u32).range(16..=8192))]
    resolution: u32,
    /// Held-out views to compare.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    views: u32,
    /// The Markdown file to write; printed in any case.
    #[arg(long)]
    out: Option<PathBuf>,
}

const NONE: Replaced = Replaced::NONE;
const ALL: Replaced = Replaced::ALL;
const ROWS: [(&str, Replaced); 13] = [
    ("nothing", NONE),
    ("silhouette", Replaced { alpha: true, ..NONE }),
    ("albedo", Replaced { albedo: true, ..NONE }),
    ("normals", Replaced { normal: true, ..NONE }),
    ("metalness and roughness", Replaced { material: true, ..NONE }),
    ("albedo, metalness and roughness", Replaced { albedo: true, material: true, ..NONE }),
    ("occlusion", Replaced { occlusion: true, ..NONE }),
    ("everything", ALL),
    ("everything but the silhouette", Replaced { alpha: false, ..ALL }),
    ("everything but albedo", Replaced { albedo: false, ..ALL }),
    ("everything but normals", Replaced { normal: false, ..ALL }),
    ("everything but metalness and roughness", Replaced { material: false, ..ALL }),
    ("everything but occlusion", Replaced { occlusion: false, ..ALL }),
];

pub(super) fn run(args: &Args) -> CommandResult {
    let options = ImportOptions { max_side: Some(args.resolution), ..ImportOptions::default() };
    let capture = import(&args.capture, &options)?;
    let replacements = ROWS.map(|(_, r)| r);
    let mut columns = Vec::new();
    for path in &args.models {
        let model = Arc::new(model_file::decode(&std::fs::read(path)?)?);
        columns.push(attribute(&model, &capture, Some(args.views as usize), &replacements)?);
    }
    let mut text = "| truth in place of the model's".to_owned();
    for path in &args.models {
        let name = path.file_stem().map_or_else(String::new, |n| n.to_string_lossy().into());
        write!(text, " | {name}")?;
    }
    writeln!(text, " |\n|---{}|", "|---:".repeat(args.models.len()))?;
    for (i, (name, _)) in ROWS.iter().enumerate() {
        write!(text, "| {name}")?;
        for column in &columns {
            write!(text, " | {}", column[i].map_or("-".to_owned(), |v| format!("{v:.2}")))?;
        }
        writeln!(text, " |")?;
    }
    print!("{text}");
    if let Some(out) = &args.out {
        output::write_named(out, text.as_bytes())?;
    }
    Ok(())
}
