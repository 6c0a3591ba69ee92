//! `relume train`: from a capture to a model file, without a server.

use std::error::Error;
use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressStyle};

use crate::capture::{Capture, GreyCard, ImportLimits};
use crate::cli::args::{named, overrides};
use crate::cli::capture::{PoseArgs, posed};
use crate::cli::error::CommandResult;
use crate::cli::light::{named_light, read_rotations};
use crate::cli::output;
use crate::engine::Device;
use crate::engine::DeviceChoice;
use crate::formats::model_file;
use crate::train::{
    Crop, KnownLight, LightExposure, Method, Preset, StepReport, TrainConfig, TrainOverrides, Trainer,
    WhiteBalance, import_for_training,
};

/// Options of `relume train`.
#[derive(Debug, clap::Args)]
pub(super) struct TrainArgs {
    /// A folder, zip, tar or tar.gz of photographs, or a clip (.mp4, .mov, .mkv, .webm). Where no poses are stated, COLMAP looks for
    /// them, and a capture with poses is made beside it.
    capture: PathBuf,
    #[command(flatten)]
    poses: PoseArgs,
    /// `draft`, `standard` or `high`.
    #[arg(long, default_value = "standard", value_parser = named::<Preset>)]
    preset: Preset,
    /// Whose model to train: `3dgs`, `gaussian-shader`, `gs-ir`, `r3dg`, `article` (each re-created inside this program, not the
    /// system's own code) or `relume`. Other options and `--set` win over what it sets.
    #[arg(long, value_parser = named::<Method>)]
    method: Option<Method>,
    /// Longest image side, pixels.
    #[arg(long)]
    resolution: Option<u32>,
    /// Optimisation steps.
    #[arg(long)]
    iterations: Option<u32>,
    /// Seed of every random choice.
    #[arg(long)]
    seed: Option<u64>,
    /// The measured light of the photographs: a `.hdr` or `.exr` file or the name of a built-in map.
    #[arg(long)]
    light: Option<String>,
    /// Turn of that light about the capture's +Z, degrees counter-clockwise.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, requires = "light")]
    light_rotation: f64,
    /// Exposure of that light, stops, or `auto`: at 0 a surface that sends a radiance of 1 is white in the photographs;
    /// `auto` gives a white surface facing up 0.9 of the luminance of white.
    #[arg(long, default_value = "0", value_parser = exposure, allow_negative_numbers = true, requires = "light")]
    light_exposure: LightExposure,
    /// Turns of the light in single photographs, for things on a turntable: a JSON file, `{"photo.jpg": degrees}`,
    /// counter-clockwise about the capture's +Z.
    #[arg(long, value_name = "FILE")]
    light_rotations: Option<PathBuf>,
    /// Colour of the light in the photographs: `auto` (estimated), `neutral` (balanced for their light), `daylight` (open
    /// sky), or its temperature in kelvin in photographs that were balanced for daylight.
    #[arg(long)]
    white_balance: Option<WhiteBalance>,
    /// A white or grey thing that all of the light falls on, in pixels of a stored photograph: its mean colour is the light's, in
    /// place of `--white-balance`.
    #[arg(long, value_name = "PHOTO:X,Y,WIDTH,HEIGHT")]
    grey_card: Option<GreyCard>,
    /// Which part of photographs without masks becomes the model, while the rest only lights it: `none`, `auto` (what stands on the
    /// ground in the ball around which the cameras stand), or a ball in units of the capture, +Z up.
    #[arg(long, value_name = "auto|X,Y,Z,RADIUS", allow_hyphen_values = true)]
    crop: Option<Crop>,
    /// Where to compute: `auto`, `cpu`, `gpu` or `gpu:N`; `relume doctor` lists them.
    #[arg(long, default_value_t)]
    device: DeviceChoice,
    /// Any other override of the preset, e.g. `--set labels=both`; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// The file for checkpoints. A training resumes from it when it exists; it is removed at the end.
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// The model file to write.
    #[arg(long, default_value = "model.safetensors")]
    out: PathBuf,
}

pub(super) fn run(args: &TrainArgs) -> CommandResult {
    let config = TrainConfig::new(args.preset, &all_overrides(args)?)?;
    let light = config.light.as_ref().map(|light| named_light(&light.environment, "")).transpose()?;
    let path = posed(&args.capture, &args.poses)?;
    let mut capture = import_for_training(&path, &config, &ImportLimits::default())?;
    if let (Some(known), Some(map)) = (&config.light, light) {
        known.illuminate(&mut capture, map);
    }
    for warning in &capture.warnings {
        eprintln!("warning: {warning}");
    }
    eprintln!(
        "{}: {} images to train on, {} held out",
        capture.layout,
        capture.train.len(),
        capture.test.len()
    );
    let device = Device::open(args.device)?;
    eprintln!("device: {}", device.name());
    let every = config.checkpoint_every.max(1);
    let mut trainer = trainer(&capture, config, &device, args.checkpoint.as_deref())?;
    train(&mut trainer, args.checkpoint.as_deref().map(|file| (file, every)))?;
    let mut model = trainer.model()?;
    // A job's model file has no time in it, so that its bytes are reproducible.
    if let Some(card) = model.card.as_object_mut() {
        card.insert("training_seconds".to_owned(), trainer.seconds().into());
    }
    output::write_named(&args.out, &model_file::encode(&model)?)?;
    if let Some(file) = args.checkpoint.as_deref().filter(|file| file.exists()) {
        std::fs::remove_file(file)?;
    }
    eprintln!("wrote {}", args.out.display());
    Ok(())
}

/// The overrides that the options make.
fn all_overrides(args: &TrainArgs) -> CommandResult<TrainOverrides> {
    let flags = [
        ("method", args.method.map(serde_json::to_value).transpose()?),
        ("resolution", args.resolution.map(Into::into)),
        ("iterations", args.iterations.map(Into::into)),
        ("seed", args.seed.map(Into::into)),
    ];
    let mut overrides = overrides(&flags, &args.set)?;
    if let Some(environment) = args.light.clone() {
        let (rotation_deg, exposure_ev) = (args.light_rotation, args.light_exposure);
        overrides.light = Some(KnownLight { environment, rotation_deg, exposure_ev });
    }
    if let Some(file) = &args.light_rotations {
        overrides.light_rotation_per_photo = Some(read_rotations(file)?);
    }
    if args.white_balance.is_some() {
        overrides.white_balance = args.white_balance;
    }
    if args.crop.is_some() {
        overrides.crop = args.crop;
    }
    if args.grey_card.is_some() {
        overrides.grey_card = args.grey_card.clone();
    }
    Ok(overrides)
}

fn exposure(text: &str) -> Result<LightExposure, String> {
    if text == "auto" {
        return Ok(LightExposure::AUTO);
    }
    text.parse().map(LightExposure::Stops).map_err(|_| format!("{text:?} is neither a number nor `auto`"))
}

/// Resumes from the checkpoint when the file exists, or starts anew.
fn trainer(
    capture: &Capture,
    config: TrainConfig,
    device: &Device,
    checkpoint: Option<&Path>,
) -> CommandResult<Trainer> {
    let Some(file) = checkpoint.filter(|file| file.exists()) else {
        return Ok(Trainer::new(capture, config, device)?);
    };
    let named = |error: &dyn Error| format!("{}: {error}", file.display());
    let bytes = std::fs::read(file).map_err(|error| named(&error))?;
    let trainer = Trainer::resume(capture, config, &bytes, device).map_err(|error| named(&error))?;
    eprintln!("going on from step {}, {}", trainer.progress().step, file.display());
    Ok(trainer)
}

/// Trains to the end; `checkpoint`: the file for the state, and the steps between two writes.
fn train(trainer: &mut Trainer, checkpoint: Option<(&Path, u32)>) -> CommandResult {
    let bar = ProgressBar::new(u64::from(trainer.progress().total));
    let style = "{bar:32} {pos}/{len} {per_sec:>12} eta {eta:>4}  {msg}";
    bar.set_style(ProgressStyle::with_template(style)?);
    while !trainer.is_done() {
        let report = trainer.step()?;
        if let Some(warning) = &report.warning {
            bar.suspend(|| eprintln!("warning: {warning}"));
        }
        let progress = trainer.progress();
        if let Some((file, _)) = checkpoint.filter(|(_, every)| progress.step.is_multiple_of(*every)) {
            output::write_named(file, &trainer.checkpoint()?)?;
        }
        // Without a terminal there is no bar: twenty lines go to the log instead.
        if bar.is_hidden() && progress.step.is_multiple_of((progress.total / 20).max(1)) {
            eprintln!("step {}/{}  {}", progress.step, progress.total, summary(&report));
        }
        bar.set_position(u64::from(progress.step));
        bar.set_message(summary(&report));
    }
    bar.finish();
    Ok(())
}

fn summary(report: &StepReport) -> String {
    format!("loss {:.4}  PSNR {:.2} dB  {} Gaussians", report.loss, report.psnr, report.gaussians)
}
