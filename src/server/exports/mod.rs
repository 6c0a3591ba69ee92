//! Exports: files that are made of models in the background.
//!
//! `routes.rs` checks and queues them. `exporter.rs` is the task that makes them: frames one at a time, with a lower priority
//! than frames of other requests; other files concurrently, also one at a time.

mod delight;
mod export_error;
mod exporter;
mod frames;
mod light;
mod light_matrix;
mod model;
mod plan;
mod queue;
mod request;
mod routes;
mod splats;
mod video;
mod work_folder;
mod zip;

pub(super) use exporter::work;
pub(super) use plan::path;
pub use queue::ExportPolicy;
pub(super) use queue::ExportQueue;
pub(super) use routes::routes;
