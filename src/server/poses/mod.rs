//! Pose estimation for photographs without poses: a stage of the validation of a capture.

mod folder;
mod log;
mod pack;
mod policy;
mod queue;
mod stage;

pub(super) use folder::{clean_up, remove_folder, remove_leftovers};
pub(super) use log::routes;
pub use policy::PosesPolicy;
pub(super) use queue::{PoseJob, PoseQueue};
pub(super) use stage::{find, needs_poses, refusal};
