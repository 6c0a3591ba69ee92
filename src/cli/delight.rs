//! `relume delight`: separates the photographs of a capture into layers by a model.

use std::path::PathBuf;
use std::sync::Arc;

use crate::cli::args::named;
use crate::cli::error::CommandResult;
use crate::cli::{input, model_capture, output};
use relume_capture::CaptureView;
use relume_engine::{Device, DeviceChoice};
use relume_spec::rendering::LayerFormat;
use relume_train::delight::{Delighter, file_stems, layer_path};

/// Options of `relume delight`.
#[derive(Debug, clap::Args)]
pub(super) struct DelightArgs {
    /// The capture: a folder or an archive.
    capture: PathBuf,
    /// A model of this capture.
    model: PathBuf,
    /// The folder for the layers.
    #[arg(long, value_name = "DIR", default_value = "layers")]
    out: PathBuf,
    /// Write a `.exr` with all layers in linear light for each photograph, or a folder of PNG files with the sRGB curve for each layer.
    #[arg(long, value_name = "exr|png", default_value = "exr", value_parser = named::<LayerFormat>)]
    format: LayerFormat,
    /// Only the photographs whose name contains this text.
    #[arg(long, value_name = "TEXT")]
    name: Option<String>,
    /// Longest side of the layers, pixels. Default: the size of the photographs.
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(16..=8192))]
    resolution: Option<u32>,
    /// Rotations of the light in single photographs, as for `train`.
    #[arg(long = "light-rotation-file", value_name = "FILE")]
    light_rotations: Option<PathBuf>,
    /// Device: `auto`, `cpu`, `gpu` or `gpu:N`.
    #[arg(long, default_value_t)]
    device: DeviceChoice,
}

pub(super) fn run(args: &DelightArgs) -> CommandResult {
    let model = Arc::new(input::read_model(&args.model)?);
    if !model.has_materials() {
        return Err(format!("{}: the model has no materials", args.model.display()).into());
    }
    let capture =
        model_capture::read(&args.capture, &model, args.resolution, args.light_rotations.as_deref())?;
    let views: Vec<&CaptureView> = capture.train.iter().chain(&capture.test).collect();
    let stems = file_stems(&views);
    let is_wanted = |view: &&CaptureView| args.name.as_ref().is_none_or(|text| view.name.contains(text));
    let wanted: Vec<&CaptureView> = views.into_iter().filter(is_wanted).collect();
    if wanted.is_empty() {
        let text = args.name.as_deref().unwrap_or_default();
        return Err(format!("--name {text}: no photograph of {} has it", args.capture.display()).into());
    }
    let mut delighter = Delighter::new(model, &Device::open(args.device)?)?;
    for (index, view) in wanted.iter().enumerate() {
        let layers = delighter.delight(view)?;
        let stem = &stems[&view.name];
        for (name, bytes) in layers.files(args.format)? {
            output::write_named(&args.out.join(layer_path(name, stem, args.format)), &bytes)?;
        }
        eprintln!("{}/{}  {}", index + 1, wanted.len(), view.name);
    }
    eprintln!("wrote {} to {}", count(wanted.len()), args.out.display());
    Ok(())
}

fn count(photographs: usize) -> String {
    if photographs == 1 {
        "the layers of 1 photograph".into()
    } else {
        format!("the layers of {photographs} photographs")
    }
}
