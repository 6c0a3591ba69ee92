//! The in-process worker: one OS thread that owns the device, trains what is queued and renders between steps.
//!
//! The thread drives one future with `block_on`, so that a training step may take as long as it needs without
//! stalling the server, and nothing else uses the device.

mod device_handle;
mod eta;
mod progress;
mod queued_render;
mod render_queue;
mod renders;
mod thread;
mod training;
mod verdict;

pub use device_handle::DeviceHandle;
pub use renders::{LightSource, ModelSource, RenderFailure, RenderTask};
pub use thread::{StartError, WorkerOptions, start};
