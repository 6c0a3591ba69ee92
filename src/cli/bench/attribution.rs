//! `relume bench attribution`: the sources of the error of relit pictures.

use std::path::PathBuf;

use crate::cli::bench::input::{BenchModel, read_capture};
use crate::cli::bench::table::{head, publish, row};
use crate::cli::error::CommandResult;
use relume_train::eval::TruthLayer::{self, Albedo, Alpha, Material, Normal, Occlusion};
use relume_train::eval::{attribute, figure};

/// Options of `relume bench attribution`.
#[derive(Debug, clap::Args)]
pub(super) struct AttributionArgs {
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
    /// The Markdown file to write. The report is also printed.
    #[arg(long)]
    out: Option<PathBuf>,
}

const ROWS: [(&str, &[TruthLayer]); 13] = [
    ("nothing", &[]),
    ("silhouette", &[Alpha]),
    ("albedo", &[Albedo]),
    ("normals", &[Normal]),
    ("metalness and roughness", &[Material]),
    ("albedo, metalness and roughness", &[Albedo, Material]),
    ("occlusion", &[Occlusion]),
    ("everything", &[Albedo, Normal, Material, Occlusion, Alpha]),
    ("everything but the silhouette", &[Albedo, Normal, Material, Occlusion]),
    ("everything but albedo", &[Normal, Material, Occlusion, Alpha]),
    ("everything but normals", &[Albedo, Material, Occlusion, Alpha]),
    ("everything but metalness and roughness", &[Albedo, Normal, Occlusion, Alpha]),
    ("everything but occlusion", &[Albedo, Normal, Material, Alpha]),
];

pub(super) fn run(args: &AttributionArgs) -> CommandResult {
    let capture = read_capture(&args.capture, args.resolution)?;
    let replacements = ROWS.map(|(_, layers)| layers);
    let (mut names, mut columns) = (Vec::new(), Vec::new());
    for path in &args.models {
        let BenchModel { name, model } = BenchModel::read(path)?;
        names.push(name);
        columns.push(attribute(&model, &capture, Some(args.views as usize), &replacements)?);
    }
    let mut text = head(&["truth in place of the model's"], names);
    for (i, (name, _)) in ROWS.iter().enumerate() {
        let cells = columns.iter().map(|column| figure(column[i], 2));
        text += &row(std::iter::once((*name).to_owned()).chain(cells));
    }
    Ok(publish(&text, args.out.as_deref())?)
}
