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
    /// Whether materials are trained.
    is_relightable: bool,
    report: Report,
}

impl Moment {
    fn novel_view(&self) -> Option<f64> {
        self.report.novel_view.psnr
    }

    fn relit(&self) -> Option<f64> {
        self.report.relit.mean.psnr.filter(|_| self.is_relightable)
    }

    fn relit_aligned(&self) -> Option<f64> {
        self.report.relit_aligned.mean.psnr.filter(|_| self.is_relightable)
    }
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
    let report = evaluate(Arc::new(model), capture, &options)?;
    Ok(Moment { step, seconds, gaussians, is_relightable: trainer.is_relightable(), report })
}

fn text(name: &str, profile: &Profile) -> String {
    let heading = format!("### {name}\n\n{:.1} s in steps.\n\n", profile.seconds);
    [heading, phases(profile), stages(profile), moments(profile)].concat()
}

/// Steps and seconds of each phase.
fn phases(profile: &Profile) -> String {
    let mut text = head(&["phase"], ["steps", "s", "ms per step", "share"]);
    for (phase, time) in &profile.phases {
        text += &row([
            phase.name().to_owned(),
            time.steps.to_string(),
            format!("{:.1}", time.seconds),
            format!("{:.2}", 1e3 * time.seconds / f64::from(time.steps.max(1))),
            share(time.seconds, profile.seconds),
        ]);
    }
    text + "\n"
}

/// Seconds of each stage, longest first.
fn stages(profile: &Profile) -> String {
    let mut text = head(&["stage"], ["s", "share"]);
    let mut stages: Vec<(&str, f64)> = profile.stages.iter().map(|(name, s)| (*name, *s)).collect();
    let other = profile.seconds - stages.iter().map(|(_, seconds)| seconds).sum::<f64>();
    stages.push(("other", other));
    stages.sort_by(|a, b| b.1.total_cmp(&a.1));
    for (name, seconds) in stages {
        text += &row([name.to_owned(), format!("{seconds:.2}"), share(seconds, profile.seconds)]);
    }
    text + "\n"
}

/// Accuracy along the way, and the gain per minute since the point before.
fn moments(profile: &Profile) -> String {
    let mut text = head(
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
        let gain = |value: fn(&Moment) -> Option<f64>| {
            let gained = before.and_then(|before| Some((value(moment)? - value(before)?, before.seconds)));
            figure(gained.map(|(gained, since)| 60.0 * gained / (moment.seconds - since)), 2)
        };
        text += &row([
            moment.step.to_string(),
            format!("{:.1}", moment.seconds),
            moment.gaussians.to_string(),
            figure(moment.novel_view(), 2),
            figure(moment.relit(), 2),
            figure(moment.relit_aligned(), 2),
            gain(Moment::novel_view),
            gain(Moment::relit_aligned),
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
        let args = TimeCurveArgs::with_points(3, 1);
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
