//! `relume materials`: lists the materials of a model, writes their masks, and saves changes of them.

use std::path::PathBuf;
use std::sync::Arc;

use crate::cli::error::CommandResult;
use crate::cli::material_args::MaterialArgs;
use crate::cli::{input, output};
use relume_scene::{Illumination, Model, srgb};
use relume_spec::rendering::{Colour, FrameFormat, Output, Tier};
use relume_train::palette::{Material, mask, materials};
use relume_train::render::{EncodeOptions, Renderer, encode_frame, orbit_camera};

/// Options of `relume materials`.
#[derive(Debug, clap::Args)]
pub(super) struct MaterialsArgs {
    /// The model file.
    model: PathBuf,
    #[command(flatten)]
    changes: MaterialArgs,
    /// Save the changes of `--edits` and `--recolour` as a JSON file for `--edits`.
    #[arg(long, value_name = "FILE")]
    save: Option<PathBuf>,
    /// Write a mask of each material to this folder, as seen from the default view: `material_N.png`, white where the surface has only
    /// this material.
    #[arg(long, value_name = "DIR")]
    masks: Option<PathBuf>,
    /// Width and height of the masks, pixels.
    #[arg(long, default_value_t = 512, value_parser = clap::value_parser!(u32).range(16..=4096), requires = "masks")]
    size: u32,
}

pub(super) fn run(args: &MaterialsArgs) -> CommandResult {
    let model = args.changes.apply(input::read_model(&args.model)?)?;
    if !model.has_materials() {
        return Err(format!("{}: the model has no materials", args.model.display()).into());
    }
    println!("material  colour   share  roughness  metalness");
    for (number, material) in materials(&model).iter().enumerate() {
        let Material { share, roughness, metalness, .. } = material;
        println!(
            "{number:>8}  {}  {:>4.1} %  {roughness:>9.2}  {metalness:>9.2}",
            colour(material),
            100.0 * share
        );
    }
    if let Some(file) = &args.save {
        let edits = args.changes.edits()?;
        output::write_named(file, (serde_json::to_string_pretty(&edits)? + "\n").as_bytes())?;
        eprintln!("wrote {}", file.display());
    }
    args.masks.as_ref().map_or(Ok(()), |folder| write_masks(&model, folder, args.size))
}

/// Mean albedo as a display colour.
fn colour(material: &Material) -> Colour {
    Colour(material.albedo.map(|a| srgb::to_u8(srgb::encode(a))))
}

fn write_masks(model: &Model, folder: &std::path::Path, size: u32) -> CommandResult {
    let camera = orbit_camera(model, None, None, (size, size))?;
    for material in 0..u32::try_from(model.prototypes.len())? {
        let renderer = Renderer::new(Arc::new(mask(model.clone(), material)?));
        // A mask needs no light.
        let light =
            renderer.prepare_light(Illumination::from(relume_scene::EnvMap::from_fn(2, 1, |_| [1.0; 3])))?;
        let frame = renderer.render(&camera, &light, Tier::Standard, &[Output::Albedo])?;
        let picture = encode_frame(&frame, &[Output::Albedo], FrameFormat::Png, &EncodeOptions::default())?;
        let file = folder.join(format!("material_{material}.png"));
        output::write_named(&file, &picture.bytes)?;
        eprintln!("wrote {}", file.display());
    }
    Ok(())
}
