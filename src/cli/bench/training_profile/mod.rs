//! `relume bench training --profile`: where the time of a training goes, and what the model gains along the way.

mod stages;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tracing_subscriber::layer::SubscriberExt;

use crate::cli::bench::input::file_name;
use crate::cli::bench::table::{head, row};
use crate::cli::bench::time_curve::TimeCurveArgs;
use crate::cli::error::CommandResult;
use relume_capture::{Capture, ImportOptions, import};
use relume_engine::Device;
use relume_spec::training::{Preset, TrainConfig};
use relume_train::Trainer;
use relume_train::eval::{EvalOptions, Report, evaluate, figure};
use stages::StageTimes;

/// A part of the training.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Phase {
    /// Colour and geometry.
    WarmUp,
    /// Materials and light.
    Materials,
}

impl Phase {
    fn name(self) -> &'static str {
        match self {
            Self::WarmUp => "warm-up",
            Self::Materials => "materials",
        }
    }
}

/// Steps and seconds of a phase.
#[derive(Debug, Clone, Copy, Default)]
struct PhaseTime {
    steps: u32,
    seconds: f64,
}

/// The model after some of the steps.
struct Moment {
    step: u32,
    seconds: f64,
    gaussians: usize,
    report: Report,
}

/// A measured training.
struct Profile {
    seconds: f64,
    phases: BTreeMap<Phase, PhaseTime>,
    stages: BTreeMap<&'static str, f64>,
    moments: Vec<Moment>,
}

/// The tables of a capture and a preset.
///
/// # Errors
/// If the capture cannot be read or the training fails.
pub(super) fn tables(
    args: &TimeCurveArgs,
    path: &Path,
    preset: Preset,
    device: &Device,
) -> CommandResult<String> {
    let overrides = args.overrides()?;
    let config = TrainConfig::new(preset, &overrides)?;
    let options = ImportOptions { max_side: Some(config.resolution), ..ImportOptions::default() };
    let capture = import(path, &options)?;
    let profile = measure(args, &capture, config, device)?;
    let name = serde_json::to_value(preset)?.as_str().unwrap_or_default().to_owned();
    Ok(text(&format!("{} `{name}`", file_name(path)), &profile))
}

fn measure(
    args: &TimeCurveArgs,
    capture: &Capture,
    config: TrainConfig,
    device: &Device,
) -> CommandResult<Profile> {
    let times = StageTimes::default();
    let subscriber = tracing_subscriber::registry().with(times.clone());
    let _collected = tracing::subscriber::set_default(subscriber);
    let mut profile =
        Profile { seconds: 0.0, phases: BTreeMap::new(), stages: BTreeMap::new(), moments: Vec::new() };
    let mut trainer = Trainer::new(capture, config, device)?;
    let total = trainer.progress().total;
    while !trainer.is_done() {
        let phase = if trainer.is_relightable() { Phase::Materials } else { Phase::WarmUp };
        let start = Instant::now();
        let step = trainer.step()?.step;
        let seconds = start.elapsed().as_secs_f64();
        let time = profile.phases.entry(phase).or_default();
        (time.steps, time.seconds) = (time.steps + 1, time.seconds + seconds);
        profile.seconds += seconds;
        if step * args.points / total > (step - 1) * args.points / total {
            // The evaluation is not a stage of the training.
            let stages = times.seconds();
            profile.moments.push(moment(args, &mut trainer, capture, device, profile.seconds)?);
            times.reset(stages);
        }
    }
    profile.stages = times.seconds();
    Ok(profile)
}

fn moment(
    args: &TimeCurveArgs,
    trainer: &mut Trainer,
    capture: &Capture,
    device: &Device,
    seconds: f64,
) -> CommandResult<Moment> {
    let model = trainer.model()?;
    let options = EvalOptions {
        views: Some(args.views as usize),
        frame_rate_time: Duration::ZERO,
        device,
        ..EvalOptions::default()
    };
    let (step, gaussians) = (trainer.progress().step, model.gaussians.len());
    Ok(Moment { step, seconds, gaussians, report: evaluate(Arc::new(model), capture, &options)? })
}

fn text(name: &str, profile: &Profile) -> String {
    let mut text = format!("### {name}\n\n{:.1} s in steps.\n\n", profile.seconds);
    text += &head(&["phase"], ["steps", "s", "ms per step", "share"]);
    for (phase, time) in &profile.phases {
        text += &row([
            phase.name().to_owned(),
            time.steps.to_string(),
            format!("{:.1}", time.seconds),
            format!("{:.2}", 1e3 * time.seconds / f64::from(time.steps.max(1))),
            share(time.seconds, profile.seconds),
        ]);
    }
    text += "\n";
    text += &head(&["stage"], ["s", "share"]);
    let mut stages: Vec<(&str, f64)> = profile.stages.iter().map(|(name, s)| (*name, *s)).collect();
    let other = profile.seconds - stages.iter().map(|(_, seconds)| seconds).sum::<f64>();
    stages.push(("other", other));
    stages.sort_by(|a, b| b.1.total_cmp(&a.1));
    for (name, seconds) in stages {
        text += &row([name.to_owned(), format!("{seconds:.2}"), share(seconds, profile.seconds)]);
    }
    text += "\n";
    text += &head(
        &["step"],
        [
            "s",
            "Gaussians",
            "novel view, dB",
            "relit, dB",
            "relit aligned, dB",
            "dB/min novel",
            "dB/min relit",
        ],
    );
    let mut before: Option<&Moment> = None;
    for moment in &profile.moments {
        let r = &moment.report;
        let gain = |value: fn(&Report) -> Option<f64>| {
            let gained = before.and_then(|before| Some((value(r)? - value(&before.report)?, before.seconds)));
            figure(gained.map(|(gained, since)| 60.0 * gained / (moment.seconds - since)), 2)
        };
        text += &row([
            moment.step.to_string(),
            format!("{:.1}", moment.seconds),
            moment.gaussians.to_string(),
            figure(r.novel_view.psnr, 2),
            figure(r.relit.mean.psnr, 2),
            figure(r.relit_aligned.mean.psnr, 2),
            gain(|r| r.novel_view.psnr),
            gain(|r| r.relit_aligned.mean.psnr),
        ]);
        before = Some(moment);
    }
    text + "\n"
}

fn share(part: f64, whole: f64) -> String {
    format!("{:.0} %", 100.0 * part / whole)
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_capture::{SyntheticOptions, synthetic};
    use relume_spec::training::TrainOverrides;

    #[test]
    fn profile_has_all_phases_stages_and_moments() {
        let options =
            SyntheticOptions { size: 24, train_views: 3, test_views: 1, paths: 4, ..Default::default() };
        let overrides = TrainOverrides {
            iterations: Some(24),
            initial_gaussians: Some(64),
            max_gaussians: Some(64),
            probe_directions: Some(8),
            ..TrainOverrides::default()
        };
        let config = TrainConfig::new(Preset::Draft, &overrides).unwrap();
        let args = TimeCurveArgs { points: 3, views: 1, ..TimeCurveArgs::default() };
        let profile = measure(&args, &synthetic(&options).unwrap(), config, &Device::Cpu).unwrap();
        let steps: Vec<u32> = profile.moments.iter().map(|moment| moment.step).collect();
        assert_eq!(steps, [8, 16, 24]);
        assert_eq!(profile.phases.values().map(|time| time.steps).sum::<u32>(), 24);
        let stages: f64 = profile.stages.values().sum();
        assert!(profile.stages.contains_key("backward") && stages > 0.0, "{:?}", profile.stages);
        assert!(stages <= profile.seconds, "{stages} of {}", profile.seconds);
        let text = text("a", &profile);
        assert!(text.contains("| materials |") && text.contains("| adam |"), "{text}");
    }
}
