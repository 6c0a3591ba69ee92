//! `relume train`: trains a model from a capture without a server.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

use crate::cli::args::{named, overrides};
use crate::cli::capture::{PoseArgs, posed};
use crate::cli::checkpoint::{CheckpointFile, TrainingStart};
use crate::cli::error::{CommandResult, EXIT_CODES, STOPPED};
use crate::cli::light::{named_light, read_rotations};
use crate::cli::output;
use crate::cli::progress::{ProgressKind, ProgressReporter, StepProgress};
use crate::cli::setting_flags::SettingFlags;
use crate::cli::sheet::sheet_beside;
use crate::cli::time_budget::{BudgetClock, Pace, planned_capture, recorded_plan};
use crate::cli::train_summary::{SummaryFiles, TrainedCapture};
use relume_capture::ImportLimits;
use relume_capture::formats::model_file;
use relume_engine::{Device, DeviceChoice};
use relume_spec::training::{
    ChartEdition, ColourChart, Crop, GreyCard, KnownLight, LightExposure, Method, Preset, TimeBudget,
    TrainConfig, TrainOverrides, TurntableCapture, Until, WhiteBalance,
};
use relume_train::time_budget::RecordedPlan;
use relume_train::{MemoryBudget, MemoryEstimate, PhotographSizes, Trainer, import_in_world};

/// Options of `relume train`.
#[derive(Debug, clap::Args)]
#[command(after_help = EXIT_CODES)]
pub(super) struct TrainArgs {
    /// A folder, zip, tar or tar.gz of photographs, or a video clip (.mp4, .mov, .mkv, .webm). If the photographs have no poses,
    /// COLMAP finds them, and a capture with poses is created beside the input.
    capture: PathBuf,
    #[command(flatten)]
    poses: PoseArgs,
    /// Preset: `draft`, `standard` or `high`.
    #[arg(long, default_value = "standard", value_parser = named::<Preset>)]
    preset: Preset,
    /// Time that the training may take, in place of a preset: `90s`, `2m`, `1h30m`. The speed of the machine is measured; pixels,
    /// Gaussians and steps are planned for the time, and the steps are planned again on the way. The time includes reading the
    /// photographs, the comparison at the end and the contact sheet, but not finding poses.
    #[arg(long, value_name = "DURATION", conflicts_with_all = ["preset", "iterations"])]
    time: Option<TimeBudget>,
    /// Stop before the last step when held-out photographs meet a condition, `novel_view.psnr>=30` or `novel_view.ssim>=0.95`, or
    /// when nothing more is gained. The step sizes still fall as at the end of a whole training.
    #[arg(long, value_name = "FIGURE>=VALUE")]
    until: Option<Until>,
    /// Repeat the training of a model whose steps were planned on the way, without a clock: a model file, or its card as `.json`. It
    /// contains all settings.
    #[arg(long, value_name = "FILE", conflicts_with_all = [
        "preset", "time", "until", "method", "resolution", "iterations", "seed", "light", "light_rotations", "light_group", "turntable_capture", "white_balance",
        "grey_card", "reflectance", "colour_chart", "crop", "set",
    ])]
    plan: Option<PathBuf>,
    /// Method to train: `relume`, or the model of a published system: `3dgs`, `gaussian-shader`, `gs-ir`, `r3dg`, `article`
    /// (re-implemented in this program; not the code of the system). Other options and `--set` override the settings of the
    /// method.
    #[arg(long, value_parser = named::<Method>)]
    method: Option<Method>,
    /// Longest image side, pixels.
    #[arg(long)]
    resolution: Option<u32>,
    /// Optimisation steps.
    #[arg(long, visible_alias = "steps")]
    iterations: Option<u32>,
    /// Seed of all random choices.
    #[arg(long)]
    seed: Option<u64>,
    /// Known light of the photographs: a `.hdr` or `.exr` file or the name of a built-in map.
    #[arg(long)]
    light: Option<String>,
    /// Rotation of this light about the capture's +Z, degrees counter-clockwise.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, requires = "light")]
    light_rotation: f64,
    /// Exposure of this light, stops, or `auto`. At 0 a surface with a radiance of 1 is white in the photographs. `auto`
    /// scales the light so that a white surface that faces up has 0.9 of the luminance of white.
    #[arg(long, default_value = "0", value_parser = exposure, allow_negative_numbers = true, requires = "light")]
    light_exposure: LightExposure,
    /// Rotations of the light in single photographs, for objects on a turntable: a JSON file `{"photo.jpg": degrees}`,
    /// counter-clockwise about the capture's +Z.
    #[arg(long = "light-rotation-file", alias = "light-rotations", value_name = "FILE")]
    light_rotations: Option<PathBuf>,
    /// Photographs that share a light, in a capture under several lights (day and evening, without and with flash): the name of the
    /// group and a pattern of file names, `*` for any characters; repeatable. Photographs that match no pattern are a further group. Each
    /// group gets a light of its own; materials and shape are common.
    #[arg(long, value_name = "NAME=PATTERN", value_parser = light_group)]
    light_group: Vec<(String, String)>,
    /// The subject turned in front of a still camera, so that the light rotates with the camera: `yes` (also without a value), `no`
    /// or `auto`, the default: yes if the photographs have masks and the background stands still while the cameras turn.
    #[arg(long, value_name = "auto|yes|no", value_parser = named::<TurntableCapture>, num_args = 0..=1, require_equals = true,
        default_missing_value = "yes")]
    turntable_capture: Option<TurntableCapture>,
    /// Colour of the light in the photographs: `auto` (estimated), `neutral` (white objects are white in the photographs), `daylight`
    /// (the light of an open sky), or the colour temperature in kelvin for photographs that were balanced for daylight.
    #[arg(long)]
    white_balance: Option<WhiteBalance>,
    /// A white or grey object in a photograph, without a shadow on it, as a rectangle in pixels of the stored photograph. Relume
    /// takes its mean colour as the colour of the light. Replaces `--white-balance`.
    #[arg(long, value_name = "PHOTO:X,Y,WIDTH,HEIGHT")]
    grey_card: Option<GreyCard>,
    /// Known linear reflectance of the grey card, 0.01 to 1 (a common one has 0.18). Relume then scales the albedo of the model so that the
    /// card has it.
    #[arg(long, value_name = "R", requires = "grey_card")]
    reflectance: Option<f32>,
    /// A classic colour chart of 24 patches in a photograph, in even light: the outer corners of its patches dark skin, bluish green, black
    /// and white, in pixels of the stored photograph. Relume corrects the colours of all photographs with the 3 x 3 matrix that the chart
    /// determines, and scales the albedo of the model to the neutral patches if the chart is part of the model.
    #[arg(long, value_name = "PHOTO:X1,Y1,X2,Y2,X3,Y3,X4,Y4", conflicts_with_all = ["grey_card", "light"])]
    colour_chart: Option<ColourChart>,
    /// When the chart was made: `since_november_2014` or `before_november_2014`.
    #[arg(long, value_parser = named::<ChartEdition>, default_value = "since_november_2014", requires = "colour_chart")]
    chart_edition: ChartEdition,
    /// Use the colour chart for the photographs only, and do not scale the albedo of the model to it.
    #[arg(long, requires = "colour_chart")]
    no_chart_level: bool,
    /// For photographs without masks: the part of the scene that becomes the model. The rest of the scene only lights it. `none`:
    /// the whole scene; `auto`: the object on the ground in the ball around which the cameras are placed; or a ball in units of
    /// the capture, +Z up.
    #[arg(long, value_name = "auto|X,Y,Z,RADIUS", allow_hyphen_values = true)]
    crop: Option<Crop>,
    /// Device: `auto`, `cpu`, `gpu` or `gpu:N`; `relume doctor` lists the devices.
    #[arg(long, default_value_t)]
    device: DeviceChoice,
    /// Any other override of the preset, e.g. `--set labels=both`; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    set: Vec<String>,
    #[command(flatten)]
    settings: SettingFlags,
    /// The checkpoint file. If it exists, the training resumes from it; it is deleted at the end. SIGTERM and Ctrl-C write it after
    /// the current step and end with exit code 75; a second signal, at least a second later or of the other kind, ends the process at once. Default: `OUT.checkpoint`, which is also
    /// written regularly in trainings of more than a minute. If that file has other settings or photographs, the command
    /// renames it to `OUT.checkpoint.old` and fails; the next run starts from the beginning.
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// Write and read no checkpoint. A signal ends the training immediately.
    #[arg(long, conflicts_with = "checkpoint")]
    no_checkpoint: bool,
    /// Format of progress reports: `human` on standard error, `json` (one object per line) or `openjd` (Open Job Description) on
    /// standard output.
    #[arg(long, value_enum, default_value_t = ProgressKind::Human, value_name = "KIND")]
    progress: ProgressKind,
    /// The model file to write. A contact sheet is written beside it: photographs, renders, two relit pictures, all layers and the
    /// error, in `model.sheet.png` for `model.safetensors`.
    #[arg(long, default_value = "model.safetensors")]
    out: PathBuf,
    /// Write no contact sheet.
    #[arg(long)]
    no_sheet: bool,
    /// LPIPS v0.1 AlexNet weights (safetensors). If given, the scores at the end include LPIPS.
    #[arg(long, value_name = "WEIGHTS", env = "RELUME_LPIPS_WEIGHTS")]
    lpips: Option<PathBuf>,
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
    let overrides = all_overrides(args)?;
    output::check_writable("--out", &args.out)?;
    if let Some(file) = &args.checkpoint {
        output::check_writable("--checkpoint", file)?;
    }
    let recorded = args.plan.as_deref().map(recorded_plan).transpose()?;
    let config = match &recorded {
        Some(_) if !args.settings.0.is_empty() => {
            return Err(format!("--plan contains all settings: leave out {}", args.settings.0[0]).into());
        }
        Some(RecordedPlan { config, .. }) => config.clone(),
        None => TrainConfig::new(args.preset, &overrides)?,
    };
    let kept = match args.no_checkpoint {
        true => None,
        false => Some(CheckpointFile::new(args.checkpoint.as_deref(), &args.out)?),
    };
    let light = config.light.as_ref().map(|light| named_light(&light.environment, "")).transpose()?;
    let path = posed(&args.capture, &args.poses)?;
    let clock = BudgetClock::start();
    let device = Device::open(args.device)?;
    progress.status(&format!("device: {}", device.name()));
    let budget = MemoryBudget::beside(&device);
    let resumed = match &kept {
        Some(kept) => kept.resumed(&config)?,
        None => None,
    };
    let (up, config) = match &resumed {
        Some(resumed) => (resumed.up, resumed.config.clone()),
        None => (config.up.into(), config),
    };
    let has_plan = recorded.is_some() || resumed.is_some();
    let (mut capture, config, cost) = if config.time_budget_s.is_some() && !has_plan {
        progress.status("measuring this machine");
        let (capture, config, cost) =
            planned_capture((&path, up), &overrides, &device, budget, &clock, !args.no_sheet)?;
        (capture, config, Some(cost))
    } else {
        (import_in_world(&path, &config, up, &ImportLimits::default(), budget)?, config, None)
    };
    if let (Some(known), Some(map)) = (&config.light, light) {
        relume_train::illuminate(known, &mut capture, map);
    }
    for warning in &capture.warnings {
        progress.warning(warning);
    }
    capture.facts().for_each(|fact| progress.status(&fact));
    let (trained, held_out) = (capture.train.len(), capture.test.len());
    progress.status(&format!("{}: {trained} images to train on, {held_out} held out", capture.layout));
    let need = MemoryEstimate::of(&PhotographSizes::of(&capture), &config, budget.on_device);
    progress.status(&format!("memory: {need}{}", left(budget)));
    let mut trained_capture = TrainedCapture::of(&capture, &path, &config);
    let timeline = recorded.map(|recorded| recorded.timeline);
    let repeats = timeline.is_some();
    let start = TrainingStart { config, timeline, resumed };
    let mut trainer = start.trainer(&capture, &device, kept.as_ref(), progress)?;
    let mut pace = match repeats {
        true => Pace::none(&clock, &device, clock.eta(&trainer, &capture)),
        false => {
            let compared = trained_capture.compared();
            Pace::of(&mut trainer, &capture, (&clock, &device), cost, compared, !args.no_sheet)?
        }
    };
    pace.announce(&trainer, progress);
    // The trainer shares the pixels that it needs.
    drop(capture);
    let before = trainer.seconds();
    if !train(&mut trainer, kept.as_ref(), (&mut pace, &mut trained_capture), progress)? {
        return Ok(ExitCode::from(STOPPED));
    }
    let mut model = trainer.model()?;
    // The model file of a job contains no time, so that its bytes are reproducible.
    if let Some(card) = model.card.as_object_mut() {
        card.insert("training_seconds".to_owned(), trainer.seconds().into());
    }
    output::write_named(&args.out, &model_file::encode(&model)?)?;
    if let Some(kept) = &kept {
        kept.delete()?;
    }
    progress.status(&waited(&trainer, trainer.seconds() - before));
    // The renderer needs the trainer's device memory.
    drop(trainer);
    let sheet = (!args.no_sheet).then(|| sheet_beside(&args.out));
    let files = SummaryFiles { sheet: sheet.as_deref(), lpips: args.lpips.as_deref(), model: &args.out };
    let lines = trained_capture.summarise(&Arc::new(model), &device, files, progress);
    if let Some(budget) = overrides.time_budget_s.map(TimeBudget) {
        progress.status(&format!("took {:.0} s of {budget}", clock.now()));
    }
    progress.done(&args.out.display().to_string(), &lines);
    Ok(ExitCode::SUCCESS)
}

/// The available memory, if known.
fn left(budget: MemoryBudget) -> String {
    budget.available.map_or_else(String::new, |bytes| format!(", {:.2} GB are available", bytes as f64 / 1e9))
}

/// The share of the training time, `seconds`, that was spent waiting for photographs.
fn waited(trainer: &Trainer, seconds: f64) -> String {
    let stats = trainer.decoding();
    let waited = stats.waited.as_secs_f64();
    format!(
        "photographs: {} decoded for {} steps; {} waits took {waited:.2} of {seconds:.1} s ({:.2} %)",
        stats.decoded,
        stats.asked,
        stats.waits,
        100.0 * waited / seconds.max(1e-9)
    )
}

/// The overrides from the options.
fn all_overrides(args: &TrainArgs) -> CommandResult<TrainOverrides> {
    let flags = [
        ("method", args.method.map(serde_json::to_value).transpose()?),
        ("resolution", args.resolution.map(Into::into)),
        ("iterations", args.iterations.map(Into::into)),
        ("seed", args.seed.map(Into::into)),
    ];
    let pairs = [&args.set[..], &args.settings.0].concat();
    let mut overrides = overrides(&flags, &pairs)?;
    if let Some(TimeBudget(seconds)) = args.time {
        overrides.time_budget_s = Some(seconds);
    }
    overrides.until = args.until.or(overrides.until);
    if let Some(environment) = args.light.clone() {
        let (rotation_deg, exposure_ev) = (args.light_rotation, args.light_exposure);
        overrides.light = Some(KnownLight { environment, rotation_deg, exposure_ev });
    }
    if let Some(file) = &args.light_rotations {
        overrides.light_rotation_per_photo = Some(read_rotations(file)?);
    }
    if !args.light_group.is_empty() {
        overrides.light_groups = Some(light_groups(&args.light_group)?);
    }
    if args.turntable_capture.is_some() {
        overrides.turntable_capture = args.turntable_capture;
    }
    if args.white_balance.is_some() {
        overrides.white_balance = args.white_balance;
    }
    if args.crop.is_some() {
        overrides.crop = args.crop;
    }
    if args.grey_card.is_some() {
        let reflectance = args.reflectance;
        overrides.grey_card = args.grey_card.clone().map(|card| GreyCard { reflectance, ..card });
    }
    if let Some(chart) = args.colour_chart.clone() {
        let (edition, level) = (args.chart_edition, !args.no_chart_level);
        overrides.colour_chart = Some(ColourChart { edition, level, ..chart });
    }
    Ok(overrides)
}

/// Reads `NAME=PATTERN`.
fn light_group(text: &str) -> Result<(String, String), String> {
    let pair = text.split_once('=').filter(|(name, pattern)| !name.is_empty() && !pattern.is_empty());
    let (name, pattern) = pair.ok_or("must be NAME=PATTERN, e.g. `evening=IMG_2*`")?;
    Ok((name.to_owned(), pattern.to_owned()))
}

/// Patterns of the light groups by name.
fn light_groups(pairs: &[(String, String)]) -> CommandResult<BTreeMap<String, String>> {
    let mut groups = BTreeMap::new();
    for (name, pattern) in pairs {
        if groups.insert(name.clone(), pattern.clone()).is_some() {
            return Err(format!("--light-group: `{name}` is given twice; use one pattern for it").into());
        }
    }
    Ok(groups)
}

fn exposure(text: &str) -> Result<LightExposure, String> {
    if text == "auto" {
        return Ok(LightExposure::AUTO);
    }
    text.parse().map(LightExposure::Stops).map_err(|_| format!("{text:?} is neither a number nor `auto`"))
}

/// Trains to the end, or until a stop is requested: then writes a checkpoint and returns `false`.
fn train(
    trainer: &mut Trainer,
    kept: Option<&CheckpointFile>,
    (pace, summary): (&mut Pace<'_>, &mut TrainedCapture),
    progress: &mut ProgressReporter,
) -> CommandResult<bool> {
    if let Some(kept) = kept {
        kept.wait();
    }
    while !trainer.is_done() {
        let report = trainer.step()?;
        if let Some(warning) = &report.warning {
            progress.warning(warning);
        }
        pace.after_step(trainer, summary, progress)?;
        let (step, total) = (trainer.progress().step, trainer.progress().total);
        let (loss, psnr) = (f64::from(report.loss), f64::from(report.psnr));
        let gaussians = report.gaussians;
        progress.step(&StepProgress {
            step,
            total,
            loss,
            psnr,
            gaussians,
            eta_seconds: pace.seconds_left(trainer),
        });
        let Some(kept) = kept else { continue };
        let stops = kept.is_stopped() && !trainer.is_done();
        if stops || kept.is_due(trainer) {
            kept.write(trainer)?;
        }
        if stops {
            // A step that was not finite is not in the checkpoint.
            let step = trainer.progress().step;
            let file = kept.path().display();
            progress.stopped(&format!("stopped after step {step} of {total}, saved in {file}"));
            return Ok(false);
        }
    }
    Ok(true)
}

#[cfg(test)]
mod tests {
    use clap::Args;

    use super::*;

    fn refused(arguments: &[&str]) -> Option<clap::error::ErrorKind> {
        let command = TrainArgs::augment_args(clap::Command::new("train"));
        let all = [&["train", "photos"], arguments].concat();
        command.try_get_matches_from(all).err().map(|error| error.kind())
    }

    #[test]
    fn a_time_replaces_preset_and_iterations() {
        use clap::error::ErrorKind;
        for other in [["--preset", "draft"], ["--iterations", "100"], ["--steps", "100"]] {
            let arguments = [&["--time", "2m"][..], &other].concat();
            assert_eq!(refused(&arguments), Some(ErrorKind::ArgumentConflict), "{other:?}");
        }
        assert_eq!(refused(&["--time", "2m", "--resolution", "200", "--until", "novel_view.psnr>=30"]), None);
        assert_eq!(refused(&["--time", "2"]), Some(ErrorKind::ValueValidation));
        assert_eq!(refused(&["--until", "psnr>=30"]), Some(ErrorKind::ValueValidation));
    }

    #[test]
    fn a_plan_contains_all_settings() {
        use clap::error::ErrorKind;
        for other in [["--time", "2m"], ["--seed", "3"], ["--set", "seed=3"], ["--preset", "high"]] {
            let arguments = [&["--plan", "m.safetensors"][..], &other].concat();
            assert_eq!(refused(&arguments), Some(ErrorKind::ArgumentConflict), "{other:?}");
        }
        assert_eq!(refused(&["--plan", "m.safetensors", "--device", "cpu"]), None, "the control");
    }
}
