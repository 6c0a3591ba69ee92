//! Exports: files that are made of models in the background.
//!
//! `routes.rs` checks and queues them, `exporter.rs` is the task that makes them: frames one at a time behind those that somebody looks
//! at, other files beside that, one at a time, too.

mod desk;
mod ended;
mod exporter;
mod frames;
mod light;
mod plan;
mod request;
mod routes;
mod splats;
mod video;
mod zip;

pub(super) use desk::ExportDesk;
pub use desk::ExportPolicy;
pub(super) use exporter::work;
pub(super) use routes::routes;
