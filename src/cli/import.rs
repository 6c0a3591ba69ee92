//! `relume import`: converts a PLY of Gaussians into a model file.

use std::path::PathBuf;

use crate::cli::error::CommandResult;
use crate::cli::light::named_light;
use crate::cli::{input, output};
use relume_capture::formats::{model_file, ply_import};
use relume_scene::softplus_inverse;

/// Columns and rows of the environment map that the model gets.
const LIGHT_SIZE: (usize, usize) = (64, 32);

/// Options of `relume import`.
#[derive(Debug, clap::Args)]
pub(super) struct ImportArgs {
    /// A `.ply` of Gaussians, written by `relume export` or by another program.
    file: PathBuf,
    /// The environment map of the model: a `.hdr` or `.exr` file or the name of a built-in map. Default: uniform white, because a
    /// PLY has no light.
    #[arg(long)]
    env: Option<String>,
    /// The model file to write.
    #[arg(long, default_value = "model.safetensors")]
    out: PathBuf,
}

pub(super) fn run(args: &ImportArgs) -> CommandResult {
    let bytes = input::read(&args.file)?;
    let mut model =
        ply_import::decode(&bytes).map_err(|error| format!("{}: {error}", args.file.display()))?;
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
