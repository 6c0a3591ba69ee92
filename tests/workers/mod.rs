//! Remote workers.

mod chaos;
mod fencing;
pub mod fleet;
mod preemption;
mod processes;
mod registry;
mod replicas;
