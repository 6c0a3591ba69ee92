//! Photographs or a clip in, a capture with poses out.

use std::path::{Path, PathBuf};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use crate::cli::error::CommandResult;
use relume_capture::poses::{
    ClipOptions, PoseOptions, PoseProgress, PoseStage, RunControl, find_poses, frames_of_clip, is_clip,
};
use relume_capture::{ImportLimits, PhotosWithoutPoses};

/// How poses are found where photographs have none.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct PoseArgs {
    /// Minutes after which COLMAP and ffmpeg are stopped.
    #[arg(long, value_name = "MINUTES", default_value_t = 240, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pose_time_limit: u64,
    /// Frames to take from a clip: the sharpest of so many intervals.
    #[arg(long, value_name = "FRAMES", default_value_t = 80, value_parser = clap::value_parser!(u32).range(3..=2000))]
    clip_frames: u32,
}

/// Options of `relume capture poses`.
#[derive(Debug, clap::Args)]
pub(super) struct CapturePosesArgs {
    /// A folder, zip, tar or tar.gz of photographs, or a clip (.mp4, .mov, .mkv, .webm).
    photographs: PathBuf,
    #[command(flatten)]
    how: PoseArgs,
    /// The folder to make. Beside the photographs, with `.poses` at its end, when absent.
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
}

pub(super) fn run(args: &CapturePosesArgs) -> CommandResult {
    let capture = find(&args.photographs, args.out.as_deref(), &args.how)?;
    match capture {
        Some(capture) => println!("{}", capture.display()),
        None => return Err(format!("{}: has poses already", args.photographs.display()).into()),
    }
    Ok(())
}

/// The capture to train on: `input` itself where it states poses, else the one that is made of it.
pub(in crate::cli) fn posed(input: &Path, args: &PoseArgs) -> CommandResult<PathBuf> {
    Ok(find(input, None, args)?.unwrap_or_else(|| input.to_owned()))
}

/// Makes a capture of photographs without poses or of a clip; `None` where there are none of these.
fn find(input: &Path, out: Option<&Path>, args: &PoseArgs) -> CommandResult<Option<PathBuf>> {
    let mut shown = PoseProgressBar::new()?;
    let mut progress = |progress| shown.progress(progress);
    // A program that is interrupted takes what it has started with it: they hear the same signal.
    let mut run_control =
        RunControl::new(Duration::from_secs(60 * args.pose_time_limit), &mut progress, &|| false);
    let photographs = if is_clip(input) {
        let frames = beside(input, "frames");
        if !frames.is_dir() {
            eprintln!("{}: taking frames, into {}", input.display(), frames.display());
            let options = ClipOptions { frames: args.clip_frames as usize, ..ClipOptions::default() };
            frames_of_clip(input, &frames, &options, &mut run_control)?;
        }
        frames
    } else {
        input.to_owned()
    };
    let Some(photos_without_poses) = PhotosWithoutPoses::open(&photographs, &ImportLimits::default())? else {
        return Ok(None);
    };
    let into = out.map_or_else(|| beside(input, "poses"), Path::to_owned);
    eprintln!(
        "{}: {} photographs without poses; COLMAP looks for them, into {}",
        photographs.display(),
        photos_without_poses.photos().len(),
        into.display()
    );
    let poses = find_poses(&photos_without_poses, &into, &PoseOptions::default(), &mut run_control)?;
    shown.finish();
    let placed = poses.photographs - poses.unregistered.len();
    let earlier = if poses.already_present { ", by an earlier run" } else { "" };
    eprintln!("{placed} of {} photographs have poses{earlier}", poses.photographs);
    if !poses.unregistered.is_empty() {
        eprintln!("warning: without a pose, and left out: {}", poses.unregistered.join(", "));
    }
    Ok(Some(into))
}

/// `thing.ENDING` beside `thing`, `thing.zip` or `thing.mp4`.
fn beside(input: &Path, ending: &str) -> PathBuf {
    // A path like `.` has no name of its own.
    let whole = input.canonicalize().unwrap_or_else(|_| input.to_owned());
    let named = if input.file_name().is_some() { input } else { &whole };
    let mut name =
        if named.is_dir() { named.file_name() } else { named.file_stem() }.unwrap_or_default().to_owned();
    name.push(format!(".{ending}"));
    named.with_file_name(name)
}

/// Progress on a terminal as a bar, else as lines.
struct PoseProgressBar {
    bar: ProgressBar,
    stage: Option<PoseStage>,
    tenth: u64,
}

impl PoseProgressBar {
    fn new() -> CommandResult<Self> {
        let bar = ProgressBar::new(0);
        bar.set_style(ProgressStyle::with_template("{msg:10} {bar:32} {pos}/{len}")?);
        Ok(Self { bar, stage: None, tenth: 0 })
    }

    fn progress(&mut self, PoseProgress { stage, done, total }: PoseProgress) {
        if self.stage != Some(stage) {
            (self.stage, self.tenth) = (Some(stage), 0);
            self.bar.set_message(stage.name());
        }
        self.bar.set_length(total);
        self.bar.set_position(done);
        let tenth = done.saturating_mul(10) / total.max(1);
        if self.bar.is_hidden() && tenth > self.tenth {
            self.tenth = tenth;
            eprintln!("{} {done}/{total}", stage.name());
        }
    }

    fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn output_folder_is_placed_beside_the_input() {
        let folder = tempfile::TempDir::new().unwrap();
        let at = folder.path();
        std::fs::create_dir(at.join("my.photos")).unwrap();
        assert_eq!(beside(&at.join("my.photos"), "poses"), at.join("my.photos.poses"));
        assert_eq!(beside(&at.join("scan.zip"), "poses"), at.join("scan.poses"));
        assert_eq!(beside(&at.join("clip.mp4"), "frames"), at.join("clip.frames"));
        assert!(beside(Path::new("."), "poses").to_string_lossy().ends_with(".poses"));
    }
}
