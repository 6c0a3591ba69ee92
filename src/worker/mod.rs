//! A worker: one thread that trains the jobs of a source, and rendering threads beside it.
//!
//! The training thread drives one future with `block_on`, so that a long training step does not block the server. All threads
//! share a device.

mod device_handle;
mod failure_report;
mod frame_server;
mod frame_thread;
mod job_source;
mod local_jobs;
mod opened_device;
mod panics;
mod previews;
mod progress;
mod queued;
mod render_queue;
mod renders;
mod start;
mod thread;
mod training;

pub use device_handle::DeviceHandle;
pub use job_source::{Claim, TrainedModel};
pub use job_source::{ClaimOutcome, JobSource, JobSourceError};
pub use local_jobs::LocalJobs;
pub use opened_device::OpenedDevice;
pub use previews::Preview;
pub use renders::{
    DecodedMaps, LightSource, LightTask, MaterialChange, ModelContent, ModelSource, RenderFailure, RenderTask,
};
pub use start::{TrainingOptions, WorkerOptions, start, start_training};
pub use thread::JobOutcome;
