//! `relume bench tradeoff`: measures time and error of every tier on the test views and lights of a capture.

mod plot;
mod report;
mod row;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;

use crate::cli::bench::input::{BenchModel, read_capture};
use crate::cli::error::CommandResult;
use crate::cli::output;
use relume_capture::{Capture, CaptureView};
use relume_engine::{Device, DeviceChoice};
use relume_spec::rendering::{Output, Quality, Tier};
use relume_train::eval::{DisplayImage, evenly_spaced, lights_of, mean_squared_error, on_white, photograph};
use relume_train::render::{Frame, PreparedLight, Renderer};
use row::Row;

/// Options of `relume bench tradeoff`.
#[derive(Debug, clap::Args)]
pub(super) struct TradeoffArgs {
    /// A capture with held-out views, ground-truth relit pictures and the environment maps of its lights.
    capture: PathBuf,
    /// Models of this capture, e.g. one per training preset.
    #[arg(required = true)]
    models: Vec<PathBuf>,
    /// The folder for the files `tradeoff` with the endings `.csv`, `.md` and `.svg`.
    #[arg(long)]
    out: PathBuf,
    /// Longest side of the views, pixels.
    #[arg(long, default_value_t = 128, value_parser = clap::value_parser!(u32).range(16..=8192))]
    resolution: u32,
    /// Number of held-out views, evenly spaced.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..))]
    views: u32,
    /// Only these lights of the capture, separated by commas. Default: all.
    #[arg(long, value_delimiter = ',')]
    lights: Vec<String>,
    /// Samples per pixel of the Monte-Carlo tier, separated by commas.
    #[arg(long, value_delimiter = ',', default_value = "4,8,16,32,64,128")]
    samples: Vec<u32>,
    /// Samples per pixel of the reference frame for the errors.
    #[arg(long, default_value_t = 1024)]
    truth_samples: u32,
    /// Renders of each frame; the fastest counts.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    repeats: u32,
    /// A device to measure in addition to the CPU engine: `gpu` or `gpu:N`; `cpu` adds none.
    #[arg(long, default_value = "cpu")]
    device: DeviceChoice,
}

pub(super) fn run(args: &TradeoffArgs) -> CommandResult {
    std::fs::create_dir_all(&args.out)?;
    let capture = read_capture(&args.capture, args.resolution)?;
    let mut devices = vec![Device::Cpu];
    devices.extend(Some(Device::open(args.device)?).filter(Device::is_gpu));
    let mut rows = Vec::new();
    for path in &args.models {
        let bench_model = BenchModel::read(path)?;
        let truths = truths(args, &capture, &bench_model)?;
        for device in &devices {
            rows.extend(measure(args, &capture, &bench_model, device, &truths)?);
        }
    }
    let introduction = format!(
        "{} threads; {} px, {} held-out views; errors are root mean squares over all pixels, against the Monte-Carlo tier \
         with {} samples on the same model and against ground truth, display-referred on white.",
        rayon::current_num_threads(),
        args.resolution,
        args.views,
        args.truth_samples
    );
    let markdown = report::markdown(&introduction, &rows);
    println!("{markdown}");
    output::write_named(&args.out.join("tradeoff.md"), markdown.as_bytes())?;
    output::write_named(&args.out.join("tradeoff.csv"), report::csv(&rows).as_bytes())?;
    output::write_named(&args.out.join("tradeoff.svg"), plot::svg(&rows)?.as_bytes())?;
    Ok(())
}

/// Frames by light and view.
type ReferenceFrames = BTreeMap<(usize, usize), Frame>;

/// The views and lights to compare.
fn cases<'a>(
    args: &TradeoffArgs,
    capture: &'a Capture,
) -> CommandResult<(Vec<&'a CaptureView>, Vec<&'a str>)> {
    let views = evenly_spaced(&capture.test, Some(args.views as usize));
    let mut lights = lights_of(&views, capture);
    if let Some(unknown) = args.lights.iter().find(|l| !lights.contains(&l.as_str())) {
        return Err(format!("--lights {unknown}: the capture has {}", lights.join(", ")).into());
    }
    lights.retain(|l| args.lights.is_empty() || args.lights.iter().any(|named| named == l));
    if lights.is_empty() {
        return Err("no light of the capture has both a map and relit truth".into());
    }
    Ok((views, lights))
}

/// Monte-Carlo frames with many samples, from a seed that no row uses.
fn truths(
    args: &TradeoffArgs,
    capture: &Capture,
    bench_model: &BenchModel,
) -> CommandResult<ReferenceFrames> {
    let (views, lights) = cases(args, capture)?;
    let renderer = Renderer::new(bench_model.model.clone());
    let quality = Quality { seed: 1, ..Quality::monte_carlo(args.truth_samples) };
    let mut out = BTreeMap::new();
    for (l, name) in lights.iter().enumerate() {
        let light = renderer.prepare_light(&capture.lights[*name])?;
        for (v, view) in views.iter().enumerate() {
            out.insert((l, v), renderer.render(&view.camera, &light, quality, &[Output::Rgb])?);
            eprintln!("{}: {} samples of view {} under {name}", bench_model.name, quality.samples, view.name);
        }
    }
    Ok(out)
}

/// Measures all tiers of one model on one device.
fn measure(
    args: &TradeoffArgs,
    capture: &Capture,
    bench_model: &BenchModel,
    device: &Device,
    truths: &ReferenceFrames,
) -> CommandResult<Vec<Row>> {
    let (views, lights) = cases(args, capture)?;
    let renderer = Renderer::on(bench_model.model.clone(), device)?;
    let sampled = args.samples.iter().map(|n| Quality::monte_carlo(*n));
    let fast = [Tier::Preview, Tier::Standard, Tier::High].map(Quality::from);
    // A GPU supports only these two.
    let wanted: Vec<Quality> =
        if device.is_gpu() { fast[..2].to_vec() } else { fast.into_iter().chain(sampled).collect() };
    let mut sums: Vec<ErrorSums> = wanted.iter().map(|_| ErrorSums::default()).collect();
    for (l, name) in lights.iter().enumerate() {
        let light = renderer.prepare_light(&capture.lights[*name])?;
        for (quality, sum) in wanted.iter().zip(&mut sums) {
            let start = Instant::now();
            renderer.render(&views[0].camera, &light, *quality, &[Output::Rgb])?;
            sum.first += start.elapsed().as_secs_f64() * 1e3;
            for (v, view) in views.iter().enumerate() {
                let (frame, ms) = timed(args, &renderer, view, &light, *quality)?;
                let relit = view.truth.relit.get(*name).map(photograph);
                sum.add(&frame, ms, &truths[&(l, v)], relit.as_ref());
            }
        }
    }
    let n = lights.len() as f64;
    Ok(wanted.iter().zip(sums).map(|(quality, sum)| sum.row(bench_model, device, *quality, n)).collect())
}

/// A frame and its minimum time, milliseconds.
fn timed(
    args: &TradeoffArgs,
    renderer: &Renderer,
    view: &CaptureView,
    light: &PreparedLight,
    quality: Quality,
) -> CommandResult<(Frame, f64)> {
    let mut least = f64::INFINITY;
    let mut frame = Frame::default();
    for _ in 0..args.repeats {
        let start = Instant::now();
        frame = renderer.render(&view.camera, light, quality, &[Output::Rgb])?;
        least = least.min(start.elapsed().as_secs_f64() * 1e3);
    }
    Ok((frame, least))
}

/// Sums over frames: times in ms, mean squared errors.
#[derive(Default)]
struct ErrorSums {
    frames: f64,
    ms: f64,
    first: f64,
    linear: f64,
    shown: f64,
    truths: f64,
    truth: f64,
}

impl ErrorSums {
    fn add(&mut self, frame: &Frame, ms: f64, reference: &Frame, relit: Option<&DisplayImage>) {
        let linear =
            |f: &Frame| f.planes.get(&Output::Rgb).map_or(Vec::new(), |p| p.as_chunks::<3>().0.to_vec());
        let (picture, wanted) = (on_white(frame, Output::Rgb), on_white(reference, Output::Rgb));
        self.frames += 1.0;
        self.ms += ms;
        self.linear += mean_squared_error(&linear(frame), &linear(reference));
        self.shown += mean_squared_error(&picture.values, &wanted.values);
        if let Some(relit) = relit {
            self.truths += 1.0;
            self.truth += mean_squared_error(&picture.values, &relit.values);
        }
    }

    fn row(self, bench_model: &BenchModel, device: &Device, quality: Quality, lights: f64) -> Row {
        let frame_ms = self.ms / self.frames;
        Row {
            model: bench_model.name.clone(),
            preset: bench_model.setting("preset"),
            training_seconds: bench_model.training_seconds(),
            device: device.name(),
            quality,
            frame_ms,
            first_ms: (self.first / lights - frame_ms).max(0.0),
            linear: (self.linear / self.frames).sqrt(),
            shown: (self.shown / self.frames).sqrt(),
            truth: (self.truths > 0.0).then(|| (self.truth / self.truths).sqrt()),
        }
    }
}
