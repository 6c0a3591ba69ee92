//! `relume capture check`: a report on photographs.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use crate::cli::args::named;
use crate::cli::capture::rig_svg::rig_svg;
use crate::cli::error::CommandResult;
use crate::cli::output::write_named;
use relume_capture::check::{FindingKind, PhotoStats, PhotographsReport, check_photographs};
use relume_capture::poses::{ClipOptions, RunControl, frames_of_clip, is_clip};
use relume_capture::{ImportLimits, ImportOptions, PhotosWithoutPoses, UndecodedCapture, has_poses, inspect};
use relume_spec::training::UpAxis;
use relume_spec::{CaptureReport, NoteKind};

/// Time limit of the extraction of frames from a clip.
const CLIP_TIME: Duration = Duration::from_secs(3600);
/// Maximum number of photographs in one line.
const SHOWN: usize = 12;

/// Options of `relume capture check`.
#[derive(Debug, clap::Args)]
pub(super) struct CheckArgs {
    /// A folder, zip, tar or tar.gz of photographs, with or without poses, or a video clip.
    photographs: PathBuf,
    /// Print a line for each photograph.
    #[arg(long)]
    each: bool,
    /// Direction in the files of a capture with poses that is up: `auto`, `x`, `y`, `z`, `-x`, `-y` or `-z`.
    #[arg(long, default_value = "auto", value_parser = named::<UpAxis>, allow_hyphen_values = true)]
    up: UpAxis,
    /// Write a picture of the cameras and the sparse points, from above and from the side, as SVG to this file.
    #[arg(long, value_name = "FILE.svg", value_parser = svg_file)]
    sheet: Option<PathBuf>,
}

pub(super) fn run(args: &CheckArgs) -> CommandResult<ExitCode> {
    let none = || format!("{}: contains no photographs", args.photographs.display());
    let scratch = tempfile::tempdir()?;
    let path = if is_clip(&args.photographs) {
        extract_frames(&args.photographs, scratch.path())?
    } else {
        args.photographs.clone()
    };
    let limits = ImportLimits::default();
    let is_sound = if has_poses(&path, &limits)? {
        check_capture(&path, args)?
    } else {
        let photographs = PhotosWithoutPoses::open(&path, &limits)?.ok_or_else(none)?;
        let report = check_photographs(&photographs);
        lines(&report, args.each).iter().for_each(|line| println!("{line}"));
        if args.sheet.is_some() {
            println!("note: no picture of the cameras is written, because the photographs have no poses");
        }
        !report.has_problems()
    };
    println!("{}", if is_sound { "suitable for training" } else { "not suitable for training" });
    Ok(if is_sound { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn svg_file(name: &str) -> Result<PathBuf, String> {
    let file = PathBuf::from(name);
    let is_svg = file.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("svg"));
    if is_svg { Ok(file) } else { Err("the name must end in .svg".to_owned()) }
}

/// Imports a capture with poses as a training does, and prints what the import found. Returns whether it can be trained on.
fn check_capture(path: &Path, args: &CheckArgs) -> CommandResult<bool> {
    let options = ImportOptions { up: args.up.into(), ..ImportOptions::default() };
    let report = match inspect(path, &options) {
        Ok(report) => report,
        Err(error) => {
            println!("problem: {error}");
            return Ok(false);
        }
    };
    if args.each {
        let photographs = PhotosWithoutPoses::ignoring_poses(path, &options.limits)?;
        let looked = photographs.as_ref().map(check_photographs);
        looked.iter().flat_map(each_line).for_each(|line| println!("{line}"));
    }
    capture_lines(&report).iter().for_each(|line| println!("{line}"));
    if let Some(file) = &args.sheet {
        let capture = UndecodedCapture::open(path, &options)?;
        let points: Vec<_> = capture.points().collect();
        write_named(file, rig_svg(&capture.cameras()?, &points, &report).as_bytes())?;
        println!("cameras drawn in {}", file.display());
    }
    Ok(true)
}

/// The findings about a capture with poses, a line each.
fn capture_lines(report: &CaptureReport) -> Vec<String> {
    let mut lines = vec![
        format!(
            "{}: {} photographs to train on, {} held out, {} x {} pixels{}",
            report.layout,
            report.train_images,
            report.test_images,
            report.width,
            report.height,
            if report.has_alpha { ", with masks" } else { "" }
        ),
        format!(
            "{} sparse points; the region of interest has a radius of {:.3} units",
            report.points, report.radius
        ),
    ];
    lines.extend(report.warnings.iter().map(|warning| format!("warning: {warning}")));
    for note in &report.notes {
        let kind = match note.kind {
            NoteKind::Hint => FindingKind::Hint,
            NoteKind::Fact => FindingKind::Note,
        };
        lines.extend(finding_lines(kind, &note.text, &note.photographs));
    }
    lines
}

/// Extracts the frames that a training on the clip uses into a folder in `scratch`.
fn extract_frames(clip: &Path, scratch: &Path) -> CommandResult<PathBuf> {
    let frames = scratch.join("frames");
    let mut ignored = |_| {};
    let mut run_control = RunControl::new(CLIP_TIME, &mut ignored, &|| false);
    frames_of_clip(clip, &frames, &ClipOptions::default(), &mut run_control)?;
    Ok(frames)
}

/// A table with a line for each photograph.
fn each_line(report: &PhotographsReport) -> Vec<String> {
    let title = "photograph  size  sharpness  brightness  clipped  similarity to the nearest".to_owned();
    std::iter::once(title).chain(report.photos.iter().map(line)).collect()
}

/// The findings about photographs without poses, a line each.
fn lines(report: &PhotographsReport, each: bool) -> Vec<String> {
    let mut lines = if each { each_line(report) } else { Vec::new() };
    let range = |of: fn(&PhotoStats) -> f64| {
        let values = || report.photos.iter().map(of);
        (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max))
    };
    lines.push(format!("{} photographs without poses", report.photos.len()));
    if !report.photos.is_empty() {
        let (sharpness, brightness, overlap) =
            (range(|p| p.sharpness), range(|p| p.brightness), range(|p| p.overlap));
        lines.push(format!(
            "sharpness {:.0} to {:.0}; brightness {:.2} to {:.2}",
            sharpness.0, sharpness.1, brightness.0, brightness.1
        ));
        lines.push(format!(
            "similarity of each to its nearest {:.2} to {:.2} (1 is the same image)",
            overlap.0, overlap.1
        ));
        lines.extend(camera(&report.photos));
    }
    for finding in &report.findings {
        lines.extend(finding_lines(finding.kind, &finding.text, &finding.photos));
    }
    lines
}

/// A finding, and a line with the photographs that it concerns.
fn finding_lines(kind: FindingKind, text: &str, photos: &[String]) -> Vec<String> {
    let mut lines = vec![format!("{}: {text}", kind.name())];
    if !photos.is_empty() {
        let shown = photos.iter().take(SHOWN).map(String::as_str).collect::<Vec<_>>().join(", ");
        let more = photos.len().saturating_sub(SHOWN);
        let more = if more > 0 { format!(" and {more} more") } else { String::new() };
        lines.push(format!("    {shown}{more}"));
    }
    lines
}

fn line(photo: &PhotoStats) -> String {
    let PhotoStats { name, size: (width, height), sharpness, brightness, clipped, overlap, .. } = photo;
    format!(
        "{name}  {width}x{height}  {sharpness:.0}  {brightness:.2}  {:.1}%  {overlap:.2}",
        clipped * 100.0
    )
}

/// The camera settings (EXIF) of the first photograph, if any.
fn camera(photos: &[PhotoStats]) -> Option<String> {
    let facts = &photos.first()?.camera;
    let parts = [
        facts.camera.clone(),
        facts.focal_mm.map(|mm| format!("{mm:.1} mm")),
        facts.f_number.map(|f| format!("f/{f:.1}")),
        facts.exposure_s.map(|s| format!("{s:.4} s")),
        facts.iso.map(|iso| format!("ISO {iso:.0}")),
    ];
    let parts: Vec<String> = parts.into_iter().flatten().collect();
    (!parts.is_empty()).then(|| format!("camera settings of the first: {}", parts.join(", ")))
}
