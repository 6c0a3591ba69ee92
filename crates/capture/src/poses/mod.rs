//! Estimates the camera poses of photographs with COLMAP, and extracts photographs from a clip with ffmpeg.
//!
//! Both are external programs on PATH. They are started without a shell, write to a log file that is kept, have a
//! time limit, and are killed if the caller cancels.

mod clip;
mod clip_probe;
mod colmap;
mod error;
mod process;
mod run_control;
mod workspace;

pub use clip::{ClipOptions, frames_of_clip, is_clip};
pub use colmap::{PoseOptions, PoseResult, colmap_version, find_poses};
pub use error::PoseError;
pub use run_control::{PoseProgress, PoseStage, RunControl};
