//! `relume bench tradeoff`: time of every tier against its error, on the test views and lights of a capture.

mod plot;
mod report;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;

use crate::capture::{Capture, CaptureView, ImportOptions, import};
use crate::cli::bench::subject::Subject;
use crate::cli::{CommandResult, output};
use crate::engine::Device;
use crate::engine::DeviceChoice;
use crate::eval::{Picture, evenly_spaced, lights_of, mean_squared_error, on_white, photograph};
use crate::render::{Frame, Output, PreparedLight, Quality, Renderer, Tier};

type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Options of `relume bench tradeoff`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// A capture with held-out views, relit truth and its lights' maps.
    capture: PathBuf,
    /// Models of it, e.g. one a training preset.
    #[arg(required = true)]
    models: Vec<PathBuf>,
    /// The folder for `tradeoff.csv`, `tradeoff.md` and `tradeoff.svg`.
    #[arg(long)]
    out: PathBuf,
    /// Longest side of the views, pixels.
    #[arg(long, default_value_t = 128, value_parser = clap::value_parser!(u32).range(16..=8192))]
    resolution: u32,
    /// Held-out views, evenly spaced.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..))]
    views: u32,
    /// Only these lights of the capture, with commas; all when absent.
    #[arg(long, value_delimiter = ',')]
    lights: Vec<String>,
    /// Samples a pixel of the reference tier, with commas.
    #[arg(long, value_delimiter = ',', default_value = "4,8,16,32,64,128")]
    samples: Vec<u32>,
    /// Samples a pixel of the picture that errors are measured against.
    #[arg(long, default_value_t = 1024)]
    truth_samples: u32,
    /// Times each frame is made; the fastest counts.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    repeats: u32,
    /// A device beside the CPU engine: `cpu` for none, `gpu` or `gpu:N`.
    #[arg(long, default_value = "cpu")]
    device: DeviceChoice,
}

/// One line of the table: a model, a device and a quality, over all views and lights.
struct Row {
    model: String,
    preset: String,
    training_seconds: Option<f64>,
    device: String,
    quality: Quality,
    /// Mean time of a frame.
    frame_ms: f64,
    /// Mean time of the first frame under a light beyond that of the others: what the tier prepares for itself.
    first_ms: f64,
    /// Root mean squared error of linear radiance against the reference tier on the same model.
    linear: f64,
    /// The same of the display-referred picture on white.
    shown: f64,
    /// Against ground truth, display-referred on white.
    truth: Option<f64>,
}

pub(super) fn run(args: &Args) -> CommandResult {
    std::fs::create_dir_all(&args.out)?;
    let options = ImportOptions { max_side: Some(args.resolution), ..ImportOptions::default() };
    let capture = import(&args.capture, &options)?;
    let mut devices = vec![Device::Cpu];
    match Device::open(args.device)? {
        Device::Cpu => {}
        gpu => devices.push(gpu),
    }
    let mut rows = Vec::new();
    for path in &args.models {
        let subject = Subject::read(path)?;
        let truths = truths(args, &capture, &subject)?;
        for device in &devices {
            rows.extend(measure(args, &capture, &subject, device, &truths)?);
        }
    }
    let markdown = report::markdown(args, &rows)?;
    println!("{markdown}");
    output::write_named(&args.out.join("tradeoff.md"), markdown.as_bytes())?;
    output::write_named(&args.out.join("tradeoff.csv"), report::csv(&rows)?.as_bytes())?;
    output::write_named(&args.out.join("tradeoff.svg"), plot::svg(&rows)?.as_bytes())?;
    Ok(())
}

/// Frames by light and view.
type Truths = BTreeMap<(usize, usize), Frame>;

/// The views and lights that are compared.
fn cases<'a>(args: &Args, capture: &'a Capture) -> Result<(Vec<&'a CaptureView>, Vec<&'a str>), Failure> {
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

/// What the reference tier says of this model with many samples, from a seed that no row has.
fn truths(args: &Args, capture: &Capture, subject: &Subject) -> Result<Truths, Failure> {
    let (views, lights) = cases(args, capture)?;
    let renderer = Renderer::new(subject.model.clone());
    let quality = Quality { seed: 1, ..Quality::reference(args.truth_samples) };
    let mut out = BTreeMap::new();
    for (l, name) in lights.iter().enumerate() {
        let light = renderer.prepare_light(&capture.lights[*name])?;
        for (v, view) in views.iter().enumerate() {
            out.insert((l, v), renderer.render(&view.camera, &light, quality, &[Output::Rgb])?);
            eprintln!("{}: {} samples of view {} under {name}", subject.name, quality.samples, view.name);
        }
    }
    Ok(out)
}

/// Every tier of one model on one device.
fn measure(
    args: &Args,
    capture: &Capture,
    subject: &Subject,
    device: &Device,
    truths: &Truths,
) -> Result<Vec<Row>, Failure> {
    let (views, lights) = cases(args, capture)?;
    let renderer = Renderer::on(subject.model.clone(), device)?;
    let sampled = args.samples.iter().map(|n| Quality::reference(*n));
    let fast = [Tier::Preview, Tier::Standard, Tier::High].map(Quality::from);
    // On a device of their own are only two.
    let wanted = match device {
        Device::Cpu => fast.into_iter().chain(sampled).collect::<Vec<_>>(),
        Device::Gpu(_) => fast[..2].to_vec(),
    };
    let mut sums: Vec<Sums> = wanted.iter().map(|_| Sums::default()).collect();
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
    Ok(wanted.iter().zip(sums).map(|(quality, sum)| sum.row(subject, device, *quality, n)).collect())
}

/// A frame and the least time it took, milliseconds.
fn timed(
    args: &Args,
    renderer: &Renderer,
    view: &CaptureView,
    light: &PreparedLight,
    quality: Quality,
) -> Result<(Frame, f64), Failure> {
    let mut least = f64::INFINITY;
    let mut frame = Frame::default();
    for _ in 0..args.repeats {
        let start = Instant::now();
        frame = renderer.render(&view.camera, light, quality, &[Output::Rgb])?;
        least = least.min(start.elapsed().as_secs_f64() * 1e3);
    }
    Ok((frame, least))
}

#[derive(Default)]
struct Sums {
    frames: f64,
    ms: f64,
    first: f64,
    linear: f64,
    shown: f64,
    truths: f64,
    truth: f64,
}

impl Sums {
    fn add(&mut self, frame: &Frame, ms: f64, reference: &Frame, relit: Option<&Picture>) {
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

    fn row(self, subject: &Subject, device: &Device, quality: Quality, lights: f64) -> Row {
        let frame_ms = self.ms / self.frames;
        Row {
            model: subject.name.clone(),
            preset: subject.setting("preset"),
            training_seconds: subject.training_seconds(),
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
