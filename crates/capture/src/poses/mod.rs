//! Camera poses of photographs that have none, by COLMAP; photographs of a clip, by ffmpeg.
//!
//! Both are programs of others that are looked for on PATH. They are started without a shell, write to a log file that is kept,
//! have a limit on time and are killed when the caller does not want their result any more.

mod clip;
mod colmap;
mod error;
mod process;
mod process_limits;
mod run_control;
mod workspace;

pub use clip::{ClipOptions, frames_of_clip, is_clip};
pub use colmap::{PoseOptions, PoseResult, colmap_version, find_poses};
pub use error::PoseError;
pub use run_control::{PoseProgress, PoseStage, RunControl};
