//! `relume import`: converts a file of Gaussians into a model file.

use std::path::PathBuf;

use crate::cli::error::CommandResult;
use crate::cli::light::named_light;
use crate::cli::{input, output};
use relume_capture::formats::model_file;
use relume_capture::formats::splat_import::{self, ImportedModel};
use relume_scene::softplus_inverse;

/// Columns and rows of the environment map that the model gets.
const LIGHT_SIZE: (usize, usize) = (64, 32);

/// Options of `relume import`.
#[derive(Debug, clap::Args)]
pub(super) struct ImportArgs {
    /// A file of Gaussians: a `.ply`, written by `relume export` or by another program, a compressed `.ply` of SuperSplat, a `.spz`
    /// or a `.splat`. The format is detected from the content of the file, not from its name.
    file: PathBuf,
    /// The environment map of the model: a `.hdr` or `.exr` file or the name of a built-in map. Default: uniform white, because
    /// such files have no light.
    #[arg(long)]
    env: Option<String>,
    /// The model file to write.
    #[arg(long, default_value = "model.safetensors")]
    out: PathBuf,
}

pub(super) fn run(args: &ImportArgs) -> CommandResult {
    let bytes = input::read(&args.file)?;
    let ImportedModel { mut model, notes } =
        splat_import::decode(&bytes).map_err(|error| format!("{}: {error}", args.file.display()))?;
    for note in &notes {
        eprintln!("warning: {}: {note}", args.file.display());
    }
    if let Some(name) = &args.env {
        let map = named_light(name, "")?.resampled(LIGHT_SIZE.0, LIGHT_SIZE.1);
        model.env_raw = map.texels().iter().map(|t| t.map(softplus_inverse)).collect();
        (model.env_width, model.env_height) = LIGHT_SIZE;
    }
    output::write_named(&args.out, &model_file::encode(&model)?)?;
    let what = if model.has_materials() { "materials" } else { "colours only, which cannot be relit" };
    eprintln!("wrote {}: {} Gaussians with {what}", args.out.display(), model.gaussians.len());
    Ok(())
}
