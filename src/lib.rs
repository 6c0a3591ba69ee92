//! Relume turns posed photographs into relightable 3D Gaussian models and serves them over HTTP.
//!
//! This package is the service and the command line. The crates below it, one sentence for each:
//!
//! - [`scene`]: the data of a relightable model; `scene::light`: harmonics, BRDF tables, operators on
//!   environments.
//! - [`spec`]: settings of trainings and frames.
//! - [`capture`]: importers from archives and folders to posed images; `capture::formats`: image and model files.
//! - [`engine`]: the differentiable renderer on the CPU and on the GPU.
//! - [`train`]: the trainer; [`render`]: a camera and a light in, a frame out; [`eval`]: metrics and contact sheets.
//! - [`api`]: the types of the HTTP API; [`client`]: a typed client of the service.
//!
//! The modules of this package, one sentence for each:
//!
//! - `traces`: the trace of a span, as a W3C `traceparent`.
//! - `camera_path`: camera paths in JSON.
//! - `store`: metadata in a database and artifacts in an object store.
//! - `jobs`: the job state machine, leases and events.
//! - `worker`: claims jobs from the queue, renders frames, stores checkpoints.
//! - `remote_worker`: a worker in a separate process, which uses only the API.
//! - `server`: the HTTP service.
//! - `testing`: starts a server on a free port for your own tests.
//! - `cli`: the command line.
//!
//! The root re-exports what most programs need: [`import`] reads a [`Capture`], a [`Trainer`] trains on it on
//! a [`Device`], and a [`Renderer`] renders the [`Model`]. A program that does not run the service can depend
//! on `relume-train` or `relume-client` alone. `cli`, `jobs` and `store` are public only for the tests and
//! benchmarks of this repository and may change with any version.

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
