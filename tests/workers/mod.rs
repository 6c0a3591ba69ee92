//! Workers with a process of their own.

mod chaos;
mod fencing;
pub mod fleet;
mod processes;
mod registry;
mod replicas;
