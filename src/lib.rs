//! Relume turns posed photographs into relightable 3D Gaussian models and serves them over HTTP.
//!
//! The modules, one sentence for each. A module imports only modules that stand above it in this list:
//!
//! - [`scene`]: what a relightable model is, as plain data.
//! - `light`: spherical harmonics, BRDF tables and the linear operators on environments.
//! - `engine`: the differentiable renderer, once in f64 for comparison and once in f32 for use.
//! - [`formats`]: bytes to plain data and back: PNG, JPEG, EXR, HDR, PLY, model files.
//! - [`capture`]: importers from archives and folders to posed images, and the synthetic scene.
//! - [`train`]: objective, optimiser, density control, schedule, checkpoints, the trainer.
//! - [`render`]: a camera and a light in, a frame or a G-buffer out.
//! - [`eval`]: metrics against ground truth, reports and contact sheets.
//! - `traces`: which trace a span belongs to, as a W3C `traceparent` (feature `server`).
//! - `api`: the types of the HTTP API (feature `server`, `client` or `cli`).
//! - `store`: metadata in SQLite and artifacts in an object store (feature `server`).
//! - `jobs`: the job state machine, leases and events (feature `server`).
//! - `worker`: takes jobs from the queue, renders frames, stores checkpoints (feature `server`).
//! - `farm`: a worker with a process of its own, over the API (features `server` and `client`).
//! - `server`: the HTTP service (feature `server`).
//! - `client`: a typed client of the service (feature `client`).
//! - `testing`: starts a server on a free port for your own tests (features `server` and `client`).
//! - `cli`: the command line (feature `cli`).
//!
//! What most programs need stands at the root: [`import`] a [`Capture`], train it with a [`Trainer`] on a [`Device`], render
//! the [`Model`] with a [`Renderer`]. `engine`, `light`, `store`, `jobs` and `cli` are public for this repository's tests
//! and benchmarks only, and may change with any version.
//!
//! Every feature is on by default. Without any, the crate trains and renders on the CPU and has no HTTP stack; the
//! feature `gpu` adds the GPU engine.

#[cfg(any(feature = "server", feature = "client", feature = "cli"))]
pub mod api;
pub mod capture;
#[cfg(feature = "cli")]
#[doc(hidden)]
pub mod cli;
#[cfg(feature = "client")]
pub mod client;
#[doc(hidden)]
pub mod engine;
pub mod eval;
#[cfg(all(feature = "server", feature = "client"))]
pub(crate) mod farm;
pub mod formats;
#[cfg(feature = "server")]
#[doc(hidden)]
pub mod jobs;
#[doc(hidden)]
pub mod light;
pub mod render;
pub mod scene;
#[cfg(feature = "server")]
pub mod server;
#[cfg(feature = "server")]
#[doc(hidden)]
pub mod store;
#[cfg(all(feature = "server", feature = "client"))]
pub mod testing;
#[cfg(feature = "server")]
pub(crate) mod traces;
pub mod train;
#[cfg(feature = "server")]
pub(crate) mod worker;

pub use capture::{Capture, CaptureError, ImportOptions, import};
#[cfg(feature = "client")]
pub use client::{Client, ClientError};
pub use engine::{Device, DeviceChoice, DeviceError};
pub use eval::{EvalOptions, Report, evaluate};
pub use render::{Frame, Output, Quality, RenderError, Renderer, Tier};
pub use scene::{Camera, EnvMap, Model};
pub use train::{Preset, TrainConfig, TrainError, TrainOverrides, Trainer};
