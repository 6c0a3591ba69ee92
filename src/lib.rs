//! Relume turns posed photographs into relightable 3D Gaussian models and serves them over HTTP.
//!
//! The map of the house, one sentence a room; imports point from the bottom of this list to the top only:
//!
//! - [`scene`]: what a relightable model is, as plain data.
//! - [`light`]: spherical harmonics, BRDF tables and the linear operators on environments.
//! - [`engine`]: the differentiable renderer, once in f64 as an oracle and once in f32 for work.
//! - [`formats`]: bytes to plain data and back: PNG, JPEG, EXR, HDR, PLY, model files.
//! - [`capture`]: importers from archives and folders to posed images, and the synthetic scene.
//! - [`train`]: objective, optimiser, density control, schedule, checkpoints, the trainer.
//! - [`render`]: a camera and a light in, a frame or a G-buffer out.
//! - [`eval`]: metrics against ground truth, reports and contact sheets.
//! - [`store`]: metadata in SQLite and artifacts in an object store.
//! - [`jobs`]: the job state machine, leases and events.
//! - [`worker`]: claims jobs, owns the device thread, heartbeats, checkpoints.
//! - [`api`]: the HTTP service.
//! - [`client`]: a typed client of the service.
//! - [`testing`]: start a server on a free port from your own tests.
//! - [`cli`]: the command line.

pub mod api;
pub mod capture;
pub mod cli;
pub mod client;
pub mod engine;
pub mod eval;
pub mod formats;
pub mod jobs;
pub mod light;
pub mod render;
pub mod scene;
pub mod store;
pub mod testing;
pub mod train;
pub mod worker;
