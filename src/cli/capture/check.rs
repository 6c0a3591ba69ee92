//! `relume capture check`: a report on photographs.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use crate::cli::error::CommandResult;
use relume_capture::check::{PhotoStats, PhotographsReport, check_photographs};
use relume_capture::poses::{ClipOptions, RunControl, frames_of_clip, is_clip};
use relume_capture::{ImportLimits, PhotosWithoutPoses};

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
}

pub(super) fn run(args: &CheckArgs) -> CommandResult<ExitCode> {
    let none = || format!("{}: contains no photographs", args.photographs.display());
    let scratch = tempfile::tempdir()?;
    let path = if is_clip(&args.photographs) {
        extract_frames(&args.photographs, scratch.path())?
    } else {
        args.photographs.clone()
    };
    let photographs =
        PhotosWithoutPoses::ignoring_poses(&path, &ImportLimits::default())?.ok_or_else(none)?;
    let report = check_photographs(&photographs);
    for line in lines(&report, args.each) {
        println!("{line}");
    }
    Ok(if report.has_problems() { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// Extracts the frames that a training on the clip uses into a folder in `scratch`.
fn extract_frames(clip: &Path, scratch: &Path) -> CommandResult<PathBuf> {
    let frames = scratch.join("frames");
    let mut ignored = |_| {};
    let mut run_control = RunControl::new(CLIP_TIME, &mut ignored, &|| false);
    frames_of_clip(clip, &frames, &ClipOptions::default(), &mut run_control)?;
    Ok(frames)
}

fn lines(report: &PhotographsReport, each: bool) -> Vec<String> {
    let mut lines = Vec::new();
    if each {
        lines.push("photograph  size  sharpness  brightness  clipped  similarity to the nearest".to_owned());
        lines.extend(report.photos.iter().map(line));
    }
    let range = |of: fn(&PhotoStats) -> f64| {
        let values = || report.photos.iter().map(of);
        (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max))
    };
    lines.push(format!("{} photographs", report.photos.len()));
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
        let kind = if finding.is_problem { "problem" } else { "hint" };
        lines.push(format!("{kind}: {}", finding.text));
        if !finding.photos.is_empty() {
            let shown = finding.photos.iter().take(SHOWN).map(String::as_str).collect::<Vec<_>>().join(", ");
            let more = finding.photos.len().saturating_sub(SHOWN);
            let more = if more > 0 { format!(" and {more} more") } else { String::new() };
            lines.push(format!("    {shown}{more}"));
        }
    }
    let conclusion =
        if report.has_problems() { "not suitable for training" } else { "suitable for training" };
    lines.push(conclusion.to_owned());
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
