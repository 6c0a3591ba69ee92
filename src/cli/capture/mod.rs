//! `relume capture`: commands for photographs before a training, and for further ones after it.

mod check;
mod next;
mod poses;
mod rig_svg;

use std::process::ExitCode;

use crate::cli::error::CommandResult;

pub(super) use poses::{PoseArgs, posed};

/// Options of `relume capture`.
#[derive(Debug, clap::Args)]
pub(super) struct CaptureArgs {
    #[command(subcommand)]
    command: CaptureCommand,
}

#[derive(Debug, clap::Subcommand)]
enum CaptureCommand {
    /// Check a capture before a training: poses, lenses, masks and points, as an import does. For photographs without poses it
    /// checks their number, blur, exposure, overlap and camera settings. Fails if the capture is not suitable for training.
    Check(check::CheckArgs),
    /// Find the poses of photographs or of a video clip, with COLMAP and ffmpeg, and make a capture of them.
    Poses(poses::CapturePosesArgs),
    /// Name the places from which further photographs would help a trained model most.
    Next(next::NextArgs),
}

pub(super) fn run(args: &CaptureArgs) -> CommandResult<ExitCode> {
    match &args.command {
        CaptureCommand::Check(args) => check::run(args),
        CaptureCommand::Next(args) => next::run(args).map(|()| ExitCode::SUCCESS),
        CaptureCommand::Poses(args) => poses::run(args).map(|()| ExitCode::SUCCESS),
    }
}
