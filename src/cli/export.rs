//! `relume export`: converts a model into a file for other programs.

use std::path::{Path, PathBuf};

use crate::cli::args::named;
use crate::cli::error::CommandResult;
use crate::cli::light::illumination;
use crate::cli::material_args::MaterialArgs;
use crate::cli::render::{finite, up_to};
use crate::cli::{input, output};
use relume_scene::Model;
use relume_spec::rendering::{ExportedColour, MAX_BAKED_DEGREE};
use relume_train::render::{
    MeshOptions, SplatBudget, SplatFile, encode_mesh_file, encode_splat_file_within, relit,
};

/// Options of `relume export`.
#[derive(Debug, clap::Args)]
pub(super) struct ExportArgs {
    /// The model file.
    model: PathBuf,
    /// The file to write. The ending selects the format: `.ply`, `.glb` (glTF with KHR_gaussian_splatting), `.usda` or `.usdz`
    /// (OpenUSD), or `.hdr` (the recovered light).
    #[arg(long, default_value = "model.ply")]
    out: PathBuf,
    /// Write a `.glb` with the surface as triangles and textures of base colour, metalness and roughness, instead of Gaussians.
    #[arg(long, conflicts_with_all = ["layer", "env", "flatten"])]
    mesh: bool,
    /// Resolution of the grid for the mesh: cells along the model's world, 16 to 512.
    #[arg(long, default_value_t = MeshOptions::default().cells as u32, value_parser = clap::value_parser!(u32).range(16..=512))]
    mesh_cells: u32,
    /// The colour of the Gaussians: `radiance` (as in the photographs), `relit` (see `--env`), `albedo`, `normal`, `roughness` or
    /// `metallic`. With this option a `.ply` is a standard file of splats; without it, the `.ply` also has the materials.
    #[arg(long, value_parser = named::<ExportedColour>)]
    layer: Option<ExportedColour>,
    /// The light of `relit`: a `.hdr` or `.exr` file, the name of a built-in map, `recovered`, or `recovered:GROUP` for a light group of the capture.
    #[arg(long, alias = "environment")]
    env: Option<String>,
    /// Rotation of this light about +Z, degrees counter-clockwise.
    #[arg(long, alias = "environment-rotation", default_value_t = 0.0, allow_negative_numbers = true, value_parser = finite,
          requires = "env")]
    rotation: f64,
    /// Exposure of this light, stops, -20 to 20.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, value_parser = up_to::<20>, requires = "env")]
    exposure: f64,
    /// SH degree of the colours of `relit`, 0 to 3. Higher degrees keep more view dependence of highlights.
    #[arg(long, default_value_t = MAX_BAKED_DEGREE as u32, value_parser = clap::value_parser!(u32).range(0..=MAX_BAKED_DEGREE as i64))]
    relit_degree: u32,
    /// Rotate each Gaussian so that its shortest axis is its shading normal, for programs that use this axis as the normal.
    #[arg(long)]
    flatten: bool,
    /// Write at most this number of Gaussians: those that contribute most to views around the model. Prints the difference from the whole
    /// model.
    #[arg(long, value_name = "N", conflicts_with = "mesh", value_parser = clap::value_parser!(u32).range(1..))]
    max_splats: Option<u32>,
    /// Write a file of at most this size, megabytes (1,000,000 bytes), with as many Gaussians as it allows.
    #[arg(long, value_name = "MB", conflicts_with = "mesh", allow_negative_numbers = true, value_parser = positive)]
    max_mb: Option<f64>,
    #[command(flatten)]
    materials: MaterialArgs,
}

pub(super) fn run(args: &ExportArgs) -> CommandResult {
    let (kind, shown) = (kind(&args.out)?, args.shown()?);
    let mut model = args.materials.apply(input::read_model(&args.model)?)?;
    if !model.has_materials() && shown != ExportedColour::Radiance {
        return Err(format!(
            "{}: the model has no materials; only `--layer radiance` is available",
            args.model.display()
        )
        .into());
    }
    if shown == ExportedColour::Relit {
        model = args.relit(model)?;
    }
    let bytes = if args.mesh { args.encode_mesh(kind, model)? } else { args.encode(kind, shown, model)? };
    output::write_named(&args.out, &bytes)?;
    eprintln!("wrote {}", args.out.display());
    Ok(())
}

/// Parses a number above 0.
fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err("must be a number above 0".to_owned()),
    }
}

impl ExportArgs {
    fn shown(&self) -> Result<ExportedColour, String> {
        match (self.layer, &self.env) {
            (Some(shown), None) => Ok(shown),
            (Some(ExportedColour::Relit) | None, Some(_)) => Ok(ExportedColour::Relit),
            (None, None) => Ok(ExportedColour::Radiance),
            (Some(_), Some(_)) => Err("--env: requires `--layer relit`".to_owned()),
        }
    }

    /// The model with its colours under the requested light.
    fn relit(&self, model: Model) -> CommandResult<Model> {
        let light = illumination(self.env.as_deref().unwrap_or("recovered"), &model)?;
        let light = light.rotated_and_scaled(self.rotation, self.exposure.exp2() as f32);
        Ok(relit(model, light, self.relit_degree as usize)?)
    }

    fn encode_mesh(&self, kind: SplatFile, model: Model) -> CommandResult<Vec<u8>> {
        if kind != SplatFile::Glb {
            return Err("--mesh: a mesh can only be written to a .glb".into());
        }
        if !model.has_materials() {
            return Err("--mesh: the model has no materials".into());
        }
        Ok(encode_mesh_file(model, self.mesh_cells as usize, &|| true)?)
    }

    fn encode(&self, kind: SplatFile, shown: ExportedColour, model: Model) -> CommandResult<Vec<u8>> {
        if kind == SplatFile::Hdr && (self.max_splats.is_some() || self.max_mb.is_some()) {
            return Err("--max-splats, --max-mb: a .hdr has no Gaussians".into());
        }
        let shown = (self.layer.is_some() || self.env.is_some()).then_some(shown);
        let bytes = self.max_mb.map(|megabytes| (megabytes * 1e6) as u64);
        let budget = SplatBudget { splats: self.max_splats, bytes };
        let file = encode_splat_file_within(model, kind, shown, self.flatten, budget, &|| true)?;
        if let Some((number, psnr_db)) = file.pruned {
            let all = file.all;
            eprintln!(
                "kept {number} of {all} Gaussians; the colours differ from the whole model by {psnr_db:.1} dB PSNR"
            );
        }
        Ok(file.bytes)
    }
}

fn kind(path: &Path) -> Result<SplatFile, String> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    match extension.as_str() {
        "ply" => Ok(SplatFile::Ply),
        "glb" => Ok(SplatFile::Glb),
        "usda" => Ok(SplatFile::Usda),
        "usdz" => Ok(SplatFile::Usdz),
        "hdr" => Ok(SplatFile::Hdr),
        _ => Err(format!("{}: must end in .ply, .glb, .usda, .usdz or .hdr", path.display())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args(layer: Option<ExportedColour>, env: Option<&str>) -> ExportArgs {
        ExportArgs {
            model: PathBuf::new(),
            out: PathBuf::new(),
            mesh: false,
            mesh_cells: 192,
            layer,
            env: env.map(str::to_owned),
            rotation: 0.0,
            exposure: 0.0,
            relit_degree: 3,
            flatten: false,
            max_splats: None,
            max_mb: None,
            materials: MaterialArgs::default(),
        }
    }

    #[test]
    fn light_option_selects_relit_and_conflicts_with_albedo() {
        assert_eq!(args(None, None).shown(), Ok(ExportedColour::Radiance));
        assert_eq!(args(None, Some("sunset")).shown(), Ok(ExportedColour::Relit));
        assert_eq!(args(Some(ExportedColour::Relit), None).shown(), Ok(ExportedColour::Relit));
        assert!(args(Some(ExportedColour::Albedo), Some("sunset")).shown().is_err());
        assert_eq!(args(Some(ExportedColour::Albedo), None).shown(), Ok(ExportedColour::Albedo));
    }

    #[test]
    fn export_format_is_chosen_by_file_extension() {
        assert_eq!(kind(Path::new("a/b.GLB")), Ok(SplatFile::Glb));
        assert_eq!(kind(Path::new("b.usdz")), Ok(SplatFile::Usdz));
        assert!(kind(Path::new("b.spz")).unwrap_err().starts_with("b.spz: "));
        assert!(kind(Path::new("ply")).is_err());
    }
}
