//! `relume capture poses`: turns photographs without poses or a video clip into a capture with poses.

use std::path::{Path, PathBuf};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use crate::cli::error::CommandResult;
use relume_capture::poses::{
    ClipOptions, PoseOptions, PoseProgress, PoseStage, RunControl, find_poses, frames_of_clip, is_clip,
};
use relume_capture::{ImportLimits, PhotosWithoutPoses};

/// Options for finding the poses of photographs.
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct PoseArgs {
    /// Time limit of COLMAP and ffmpeg, minutes.
    #[arg(long, value_name = "MINUTES", default_value_t = 240, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pose_time_limit: u64,
    /// Number of frames to extract from a clip. The clip is divided into as many intervals; each yields its sharpest frame.
    #[arg(long, value_name = "FRAMES", default_value_t = 80, value_parser = clap::value_parser!(u32).range(3..=2000))]
    clip_frames: u32,
}

/// Options of `relume capture poses`.
#[derive(Debug, clap::Args)]
pub(super) struct CapturePosesArgs {
    /// A folder, zip, tar or tar.gz of photographs, or a video clip (.mp4, .mov, .mkv, .webm).
    photographs: PathBuf,
    #[command(flatten)]
    how: PoseArgs,
    /// The folder to create. Default: beside the photographs, with the suffix `.poses`.
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
}

pub(super) fn run(args: &CapturePosesArgs) -> CommandResult {
    let capture = find(&args.photographs, args.out.as_deref(), &args.how)?;
    match capture {
        Some(capture) => println!("{}", capture.display()),
        None => return Err(format!("{}: already has poses", args.photographs.display()).into()),
    }
    Ok(())
}

/// The capture to train on: `input` if it has poses, otherwise the capture that is made of it.
pub(in crate::cli) fn posed(input: &Path, args: &PoseArgs) -> CommandResult<PathBuf> {
    Ok(find(input, None, args)?.unwrap_or_else(|| input.to_owned()))
}

/// Makes a capture of photographs without poses or of a clip; `None` if `input` has poses.
fn find(input: &Path, out: Option<&Path>, args: &PoseArgs) -> CommandResult<Option<PathBuf>> {
    let mut shown = PoseProgressBar::new()?;
    let mut progress = |progress| shown.progress(progress);
    // No stop check is needed: an interrupt signal also reaches the child processes.
    let mut run_control =
        RunControl::new(Duration::from_secs(60 * args.pose_time_limit), &mut progress, &|| false);
    let photographs = if is_clip(input) {
        let frames = beside(input, "frames");
        if !frames.is_dir() {
            eprintln!("{}: extracting frames into {}", input.display(), frames.display());
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
    for file in photos_without_poses.ignored() {
        eprintln!("not used: {} {}", file.path, file.reason);
    }
    let into = out.map_or_else(|| beside(input, "poses"), Path::to_owned);
    eprintln!(
        "{}: photographs without poses: {}; finding poses with COLMAP, into {}",
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
        eprintln!("warning: left out, because COLMAP found no pose: {}", poses.unregistered.join(", "));
    }
    Ok(Some(into))
}

/// `thing.ENDING` beside `thing`, `thing.zip` or `thing.mp4`.
fn beside(input: &Path, ending: &str) -> PathBuf {
    // A path such as `.` has no file name.
    let whole = input.canonicalize().unwrap_or_else(|_| input.to_owned());
    let named = if input.file_name().is_some() { input } else { &whole };
    let mut name =
        if named.is_dir() { named.file_name() } else { named.file_stem() }.unwrap_or_default().to_owned();
    name.push(format!(".{ending}"));
    named.with_file_name(name)
}

/// Shows progress as a bar on a terminal, otherwise as lines.
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
