//! Remote workers.

mod chaos;
mod fencing;
pub mod fleet;
mod processes;
mod registry;
mod replicas;
