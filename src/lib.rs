//! Relume turns posed photographs into relightable 3D Gaussian models and serves them over HTTP.
//!
//! This package is the service and the command line. The crates below it, one sentence for each:
//!
//! - [`scene`]: what a relightable model is, as plain data; `scene::light`: harmonics, BRDF tables, operators on environments.
//! - [`spec`]: settings of trainings and frames.
//! - [`capture`]: importers from archives and folders to posed images; `capture::formats`: image and model files.
//! - [`engine`]: the differentiable renderer on the CPU and on the GPU.
//! - [`train`]: the trainer; [`render`]: a camera and a light in, a frame out; [`eval`]: metrics and contact sheets.
//! - [`api`]: the types of the HTTP API; [`client`]: a typed client of the service.
//!
//! The modules of this package, one sentence for each:
//!
//! - `traces`: which trace a span belongs to, as a W3C `traceparent`.
//! - `camera_path`: camera paths in JSON.
//! - `store`: metadata in a database and artifacts in an object store.
//! - `jobs`: the job state machine, leases and events.
//! - `worker`: takes jobs from the queue, renders frames, stores checkpoints.
//! - `remote_worker`: a worker with a process of its own, over the API.
//! - `server`: the HTTP service.
//! - `testing`: starts a server on a free port for your own tests.
//! - `cli`: the command line.
//!
//! What most programs need stands at the root: [`import`] a [`Capture`], train it with a [`Trainer`] on a [`Device`], render
//! the [`Model`] with a [`Renderer`]. A program without the service depends on `relume-train` or `relume-client` alone.

mod camera_path;
#[doc(hidden)]
pub mod cli;
#[doc(hidden)]
pub mod jobs;
pub(crate) mod remote_worker;
pub mod server;
#[doc(hidden)]
pub mod store;
pub mod testing;
pub(crate) mod traces;
pub(crate) mod worker;

pub use relume_api as api;
pub use relume_capture as capture;
pub use relume_client as client;
pub use relume_engine as engine;
pub use relume_scene as scene;
pub use relume_spec as spec;
pub use relume_train as train;
pub use relume_train::{eval, render};

pub use relume_capture::{Capture, CaptureError, ImportOptions, import};
pub use relume_client::{Client, ClientError};
pub use relume_engine::{Device, DeviceChoice, DeviceError, Frame};
pub use relume_scene::{Camera, EnvMap, Model};
pub use relume_spec::rendering::{Output, Quality, Tier};
pub use relume_spec::training::{Preset, TrainConfig, TrainOverrides};
pub use relume_train::eval::{EvalOptions, Report, evaluate};
pub use relume_train::render::{RenderError, Renderer};
pub use relume_train::{TrainError, Trainer};
