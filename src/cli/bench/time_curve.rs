//! `relume bench training`: what a training gains by more time. Each capture is trained by the command `relume train` with each
//! time budget and preset, and its held-out photographs are compared at their stored size.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::cli::args::{named, overrides};
use crate::cli::bench::input::file_name;
use crate::cli::bench::plot::{self, Panel, Series};
use crate::cli::bench::table::{head, machine, row};
use crate::cli::bench::training_profile;
use crate::cli::error::CommandResult;
use crate::cli::{input, output};
use relume_capture::{Capture, ImportOptions, import};
use relume_engine::{Device, DeviceChoice};
use relume_scene::Model;
use relume_spec::rendering::Tier;
use relume_spec::training::{Preset, TrainOverrides};
use relume_train::eval::{EvalOptions, Lpips, Report, evaluate, figure};
use relume_train::time_budget::RecordedPlan;
use relume_train::{colour_matrix_of_card, turntable_of_card, up_of_card};

/// Options of `relume bench training`.
#[derive(Debug, Default, clap::Args)]
pub(super) struct TimeCurveArgs {
    /// Captures with held-out views. Relit columns need ground-truth relit pictures and the maps of their lights.
    #[arg(required = true)]
    captures: Vec<PathBuf>,
    /// Time budgets, as of `relume train --time`, separated by commas.
    #[arg(long, value_delimiter = ',', default_value = "30s,2m")]
    times: Vec<String>,
    /// Presets to compare with, separated by commas.
    #[arg(long, value_delimiter = ',', default_value = "draft", value_parser = named::<Preset>)]
    presets: Vec<Preset>,
    /// Device: `auto`, `cpu`, `gpu` or `gpu:N`.
    #[arg(long, default_value_t)]
    device: DeviceChoice,
    /// Seed of all random choices.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Number of held-out views to compare, evenly spaced.
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) views: u32,
    /// Measure where the time of each preset goes, by phase and stage, and the accuracy along the way. The file is `profile` with the ending `.md`.
    #[arg(long, conflicts_with_all = ["times", "lpips"])]
    profile: bool,
    /// With `--profile`: number of points at which the model is evaluated, evenly spaced.
    #[arg(long, default_value_t = 8, requires = "profile", value_parser = clap::value_parser!(u32).range(1..=100))]
    pub(super) points: u32,
    /// With `--profile`: another value of a training setting; repeatable.
    #[arg(long, value_name = "KEY=VALUE", requires = "profile")]
    set: Vec<String>,
    /// LPIPS v0.1 AlexNet weights (safetensors).
    #[arg(long, value_name = "WEIGHTS", env = "RELUME_LPIPS_WEIGHTS")]
    lpips: Option<PathBuf>,
    /// The folder for the models and the files `training` with the endings `.md` and `.svg`.
    #[arg(long)]
    out: PathBuf,
}

/// The columns after the capture and the training.
const COLUMNS: [&str; 9] = [
    "s, whole command",
    "px",
    "steps",
    "Gaussians",
    "novel view, dB",
    "SSIM",
    "LPIPS",
    "relit, dB",
    "relit aligned, dB",
];

/// How long a training may take.
#[derive(Debug, Clone)]
struct Extent {
    /// The option of `relume train`.
    option: &'static str,
    value: String,
}

/// One measured training.
struct Point {
    extent: Extent,
    /// Seconds of the whole command.
    seconds: f64,
    model: Arc<Model>,
    report: Report,
}

pub(super) fn run(args: &TimeCurveArgs) -> CommandResult {
    std::fs::create_dir_all(&args.out)?;
    let device = Device::open(args.device)?;
    if args.profile {
        return profile(args, &device);
    }
    let lpips = args.lpips.as_deref().map(Lpips::read).transpose()?;
    let mut text = format!(
        "{}; seed {}; {} held-out views at their stored size, tier `standard`.\n\n{}",
        machine(&device),
        args.seed,
        args.views,
        head(&["capture", "training"], COLUMNS)
    );
    println!("{text}");
    let mut curves = Vec::new();
    for path in &args.captures {
        let mut points = Vec::new();
        for extent in extents(args)? {
            let point = measure(args, path, extent, &device, lpips.as_ref())?;
            let line = row(cells(file_name(path), &point));
            print!("{line}");
            text += &line;
            // The file is written after each row, so that an interrupted run keeps its results.
            output::write_named(&args.out.join("training.md"), text.as_bytes())?;
            points.push(point);
        }
        curves.push((file_name(path), points));
    }
    let panels = vec![similarity_panel(&curves), relit_panel(&curves)];
    Ok(output::write_named(&args.out.join("training.svg"), plot::svg(panels)?.as_bytes())?)
}

/// Writes the profile of each capture and preset.
fn profile(args: &TimeCurveArgs, device: &Device) -> CommandResult {
    let mut text = format!("{}; seed {}; {} held-out views.\n\n", machine(device), args.seed, args.views);
    print!("{text}");
    for path in &args.captures {
        for preset in &args.presets {
            let tables = training_profile::tables(args, path, *preset, device)?;
            print!("{tables}");
            text += &tables;
            output::write_named(&args.out.join("profile").with_extension("md"), text.as_bytes())?;
        }
    }
    Ok(())
}

#[cfg(test)]
impl TimeCurveArgs {
    /// Arguments of a profile with this many points and held-out views.
    pub(super) fn with_points(points: u32, views: u32) -> Self {
        Self { points, views, ..Self::default() }
    }
}

impl TimeCurveArgs {
    /// The settings of `--set` and `--seed`.
    ///
    /// # Errors
    /// Names the invalid setting.
    pub(super) fn overrides(&self) -> Result<TrainOverrides, String> {
        overrides(&[("seed", Some(self.seed.into()))], &self.set)
    }
}

/// The trainings of each capture.
fn extents(args: &TimeCurveArgs) -> CommandResult<Vec<Extent>> {
    let mut all = Vec::new();
    for preset in &args.presets {
        let value = serde_json::to_value(preset)?.as_str().unwrap_or_default().to_owned();
        all.push(Extent { option: "--preset", value });
    }
    all.extend(args.times.iter().map(|time| Extent { option: "--time", value: time.clone() }));
    Ok(all)
}

/// Trains on `path` with `relume train` and compares the model with the held-out photographs.
fn measure(
    args: &TimeCurveArgs,
    path: &Path,
    extent: Extent,
    device: &Device,
    lpips: Option<&Lpips>,
) -> CommandResult<Point> {
    let file = args.out.join(format!("{}-{}.safetensors", file_name(path), extent.value));
    let start = Instant::now();
    let status = Command::new(std::env::current_exe()?)
        .args(["train", "--device", &args.device.to_string(), "--seed", &args.seed.to_string()])
        .args([extent.option, &extent.value, "--out"])
        .arg(&file)
        .arg(path)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()?;
    let seconds = start.elapsed().as_secs_f64();
    if !status.success() {
        return Err(
            format!("relume train {} {} {}: {status}", extent.option, extent.value, path.display()).into()
        );
    }
    let model = Arc::new(input::read_model(&file)?);
    let capture = held_out(path, &model)?;
    let options = EvalOptions {
        views: Some(args.views as usize),
        quality: Tier::Standard.into(),
        frame_rate_time: Duration::ZERO,
        lpips,
        device,
        ..EvalOptions::default()
    };
    let report = evaluate(model.clone(), &capture, &options)?;
    Ok(Point { extent, seconds, model, report })
}

/// The capture at its stored size, in the world and with the colours of `model`.
fn held_out(path: &Path, model: &Model) -> CommandResult<Capture> {
    let (up, turntable) = (up_of_card(&model.card)?, turntable_of_card(&model.card)?);
    let colour_matrix = colour_matrix_of_card(&model.card)?;
    Ok(import(path, &ImportOptions { up, turntable, colour_matrix, ..ImportOptions::default() })?)
}

fn cells(capture: String, point: &Point) -> [String; 11] {
    let setting = |key: &str| {
        let value = point.model.card.get("config").and_then(|config| config.get(key));
        value.and_then(serde_json::Value::as_u64).map_or_else(|| "-".to_owned(), |value| value.to_string())
    };
    let r = &point.report;
    [
        capture,
        format!("`{} {}`", point.extent.option, point.extent.value),
        format!("{:.0}", point.seconds),
        setting("resolution"),
        RecordedPlan::of_card(&point.model.card)
            .map_or_else(|_| "-".to_owned(), |plan| plan.timeline.total().to_string()),
        point.model.gaussians.len().to_string(),
        figure(r.novel_view.psnr, 2),
        figure(r.novel_view.ssim, 3),
        figure(r.novel_view.lpips, 3),
        figure(r.relit.mean.psnr, 2),
        figure(r.relit_aligned.mean.psnr, 2),
    ]
}

/// One series for each capture, of the points for which `error` is known.
fn series(curves: &[(String, Vec<Point>)], error: impl Fn(&Report) -> Option<f64>) -> Vec<Series> {
    let of = |(name, points): &(String, Vec<Point>)| {
        let mut points: Vec<_> = points
            .iter()
            .filter_map(|p| Some((p.seconds, error(&p.report)?, p.extent.value.clone())))
            .collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        Series { name: name.clone(), unjoined: 0, points }
    };
    curves.iter().map(of).collect()
}

fn similarity_panel(curves: &[(String, Vec<Point>)]) -> Panel {
    Panel {
        title: "Held-out photographs at their stored size",
        x_label: "seconds of the command",
        y_label: "1 - SSIM",
        series: series(curves, |r| r.novel_view.ssim.map(|ssim| 1.0 - ssim)),
    }
}

fn relit_panel(curves: &[(String, Vec<Point>)]) -> Panel {
    Panel {
        title: "Relit pictures",
        x_label: "seconds of the command",
        y_label: "error against ground truth (shown)",
        series: series(curves, |r| r.relit.mean.psnr.map(|psnr| 10f64.powf(-psnr / 20.0))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_capture::{SyntheticOptions, synthetic};
    use relume_spec::training::TrainConfig;
    use relume_train::Trainer;

    /// A model of a tiny capture and its scores.
    fn point(seconds: f64, iterations: u32) -> Point {
        let options =
            SyntheticOptions { size: 24, train_views: 3, test_views: 1, paths: 4, ..Default::default() };
        let capture = synthetic(&options).unwrap();
        let overrides = TrainOverrides {
            iterations: Some(iterations),
            initial_gaussians: Some(64),
            max_gaussians: Some(64),
            probe_directions: Some(8),
            ..TrainOverrides::default()
        };
        let config = TrainConfig::new(Preset::Draft, &overrides).unwrap();
        let mut trainer = Trainer::new(&capture, config, &Device::Cpu).unwrap();
        while !trainer.is_done() {
            trainer.step().unwrap();
        }
        let model = Arc::new(trainer.model().unwrap());
        let report = evaluate(model.clone(), &capture, &EvalOptions::default()).unwrap();
        Point { extent: Extent { option: "--time", value: format!("{seconds}s") }, seconds, model, report }
    }

    #[test]
    fn curves_are_sorted_by_time_and_cells_state_scores() {
        let curves = [("a<b".to_owned(), vec![point(9.0, 24), point(2.0, 12)])];
        let cells = cells(curves[0].0.clone(), &curves[0].1[1]);
        assert_eq!(cells[..6], ["a<b", "`--time 2s`", "2", "160", "12", "64"]);
        assert_eq!(cells[8], "-", "no LPIPS weights");
        assert!(cells[9].parse::<f64>().unwrap() > 5.0, "relit: {cells:?}");
        let similarity = similarity_panel(&curves);
        let points = &similarity.series[0].points;
        assert_eq!((points[0].0, points[1].0), (2.0, 9.0));
        let ssim = curves[0].1[0].report.novel_view.ssim.unwrap();
        assert!((points[1].1 - (1.0 - ssim)).abs() < 1e-12);
        let figure = plot::svg(vec![similarity, relit_panel(&curves)]).unwrap();
        assert!(figure.contains("Relit pictures") && figure.contains("a&lt;b") && !figure.contains("a<b"));
    }
}
