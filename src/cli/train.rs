//! `relume train`: from a capture to a model file, without a server.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use crate::cli::args::{named, overrides};
use crate::cli::capture::{PoseArgs, posed};
use crate::cli::error::{CommandResult, EXIT_CODES, STOPPED};
use crate::cli::light::{named_light, read_rotations};
use crate::cli::output;
use crate::cli::progress::{ProgressKind, ProgressReporter, StepProgress};
use crate::cli::stop::StopSignal;
use relume_capture::formats::model_file;
use relume_capture::{Capture, ImportLimits};
use relume_engine::Device;
use relume_engine::DeviceChoice;
use relume_spec::training::GreyCard;
use relume_spec::training::{
    Crop, KnownLight, LightExposure, Method, Preset, TrainConfig, TrainOverrides, WhiteBalance,
};
use relume_train::{MemoryBudget, MemoryEstimate, PhotographSizes, Trainer, import_for_training};

/// Options of `relume train`.
#[derive(Debug, clap::Args)]
#[command(after_help = EXIT_CODES)]
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
    /// The file for checkpoints. A training resumes from it when it exists; it is removed at the end. With it SIGTERM and Ctrl-C
    /// write one after the step that runs and end with exit code 75; the second one ends at once.
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// How progress is said: `human` on standard error, `json` (an object a line) or `openjd` (Open Job Description) on standard output.
    #[arg(long, value_enum, default_value_t = ProgressKind::Human, value_name = "KIND")]
    progress: ProgressKind,
    /// The model file to write.
    #[arg(long, default_value = "model.safetensors")]
    out: PathBuf,
}

pub(super) fn run(args: &TrainArgs) -> CommandResult<ExitCode> {
    let mut progress = ProgressReporter::new(args.progress)?;
    let outcome = run_with(args, &mut progress);
    if let Err(error) = &outcome {
        progress.fail(&error.to_string());
    }
    outcome
}

fn run_with(args: &TrainArgs, progress: &mut ProgressReporter) -> CommandResult<ExitCode> {
    let config = TrainConfig::new(args.preset, &all_overrides(args)?)?;
    let kept = args.checkpoint.as_deref().map(|file| CheckpointFile::new(file, &config)).transpose()?;
    let light = config.light.as_ref().map(|light| named_light(&light.environment, "")).transpose()?;
    let path = posed(&args.capture, &args.poses)?;
    let device = Device::open(args.device)?;
    progress.status(&format!("device: {}", device.name()));
    let budget = MemoryBudget::beside(&device);
    let mut capture = import_for_training(&path, &config, &ImportLimits::default(), budget)?;
    if let (Some(known), Some(map)) = (&config.light, light) {
        relume_train::illuminate(known, &mut capture, map);
    }
    for warning in &capture.warnings {
        progress.warning(warning);
    }
    let (trained, held_out) = (capture.train.len(), capture.test.len());
    progress.status(&format!("{}: {trained} images to train on, {held_out} held out", capture.layout));
    let need = MemoryEstimate::of(&PhotographSizes::of(&capture), &config, budget.on_device);
    progress.status(&format!("memory: {need}{}", left(budget)));
    let mut trainer = trainer(&capture, config, &device, args.checkpoint.as_deref(), progress)?;
    // The trainer shares the pixels that it needs.
    drop(capture);
    let before = trainer.seconds();
    if !train(&mut trainer, kept.as_ref(), progress)? {
        return Ok(ExitCode::from(STOPPED));
    }
    let mut model = trainer.model()?;
    // A job's model file has no time in it, so that its bytes are reproducible.
    if let Some(card) = model.card.as_object_mut() {
        card.insert("training_seconds".to_owned(), trainer.seconds().into());
    }
    output::write_named(&args.out, &model_file::encode(&model)?)?;
    if let Some(file) = args.checkpoint.as_deref().filter(|file| file.exists()) {
        std::fs::remove_file(file)?;
    }
    progress.status(&waited(&trainer, trainer.seconds() - before));
    progress.done(&args.out.display().to_string());
    Ok(ExitCode::SUCCESS)
}

/// What memory is available, where that is known.
fn left(budget: MemoryBudget) -> String {
    budget.available.map_or_else(String::new, |bytes| format!(", {:.2} GB are available", bytes as f64 / 1e9))
}

/// How much of the `seconds` of its steps a training waited for photographs.
fn waited(trainer: &Trainer, seconds: f64) -> String {
    let stats = trainer.decoding();
    let waited = stats.waited.as_secs_f64();
    format!(
        "photographs: {} decoded for {} steps, which waited for {} of them: {waited:.2} of {seconds:.1} s ({:.2} %)",
        stats.decoded,
        stats.asked,
        stats.waits,
        100.0 * waited / seconds.max(1e-9)
    )
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

/// Where and when the state of a training is kept.
struct CheckpointFile<'a> {
    file: &'a Path,
    /// Steps between two writes.
    every: u32,
    stop: StopSignal,
}

impl<'a> CheckpointFile<'a> {
    fn new(file: &'a Path, config: &TrainConfig) -> CommandResult<Self> {
        Ok(Self { file, every: config.checkpoint_every.max(1), stop: StopSignal::listen()? })
    }
}

/// Resumes from the checkpoint when the file exists, or starts anew.
fn trainer(
    capture: &Capture,
    config: TrainConfig,
    device: &Device,
    checkpoint: Option<&Path>,
    progress: &ProgressReporter,
) -> CommandResult<Trainer> {
    let Some(file) = checkpoint.filter(|file| file.exists()) else {
        return Ok(Trainer::new(capture, config, device)?);
    };
    let named = |error: &dyn Error| format!("{}: {error}", file.display());
    let bytes = std::fs::read(file).map_err(|error| named(&error))?;
    let trainer = Trainer::resume(capture, config, &bytes, device).map_err(|error| named(&error))?;
    progress.status(&format!("going on from step {}, {}", trainer.progress().step, file.display()));
    Ok(trainer)
}

/// Trains to the end, or until a stop is asked for: `false` then, with the checkpoint written.
fn train(
    trainer: &mut Trainer,
    kept: Option<&CheckpointFile<'_>>,
    progress: &mut ProgressReporter,
) -> CommandResult<bool> {
    if let Some(kept) = kept {
        kept.stop.wait();
    }
    while !trainer.is_done() {
        let report = trainer.step()?;
        if let Some(warning) = &report.warning {
            progress.warning(warning);
        }
        let (step, total) = (trainer.progress().step, trainer.progress().total);
        let (loss, psnr) = (f64::from(report.loss), f64::from(report.psnr));
        let gaussians = report.gaussians;
        progress.step(&StepProgress { step, total, loss, psnr, gaussians, eta_seconds: None });
        let Some(CheckpointFile { file, every, stop }) = kept else { continue };
        let stops = stop.is_requested() && !trainer.is_done();
        if stops || step.is_multiple_of(*every) {
            output::write_named(file, &trainer.checkpoint()?)?;
        }
        if stops {
            // A step that was not finite is not in the checkpoint.
            let kept = trainer.progress().step;
            progress.stopped(&format!("stopped after step {kept} of {total}, kept in {}", file.display()));
            return Ok(false);
        }
    }
    Ok(true)
}
