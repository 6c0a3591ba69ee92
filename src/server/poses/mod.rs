//! Poses for photographs that come without: a stage of the validation of a capture.

mod queue;
mod folder;
mod log;
mod pack;
mod policy;
mod stage;

pub(super) use queue::{PoseQueue, PoseJob};
pub(super) use folder::{remove_leftovers, remove_folder, clean_up};
pub(super) use log::routes;
pub use policy::PosesPolicy;
pub(super) use stage::{needs_poses, find, refusal};
