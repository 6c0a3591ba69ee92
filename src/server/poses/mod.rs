//! Poses for photographs that come without: a stage of the validation of a capture.

mod desk;
mod folder;
mod log;
mod pack;
mod policy;
mod stage;

pub(super) use desk::{Desk, Ticket};
pub(super) use folder::{remove_left_over, remove_of, tidy};
pub(super) use log::routes;
pub use policy::PosesPolicy;
pub(super) use stage::{are_wanted, find, refusal};
