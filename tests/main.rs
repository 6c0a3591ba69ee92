//! Black-box tests, one module a subject, one binary.

// Helpers of tests are tests: a failed one should say where.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod architecture;
mod captures;
mod crash;
mod eval;
mod extremes;
mod gpu;
mod hostile;
mod lights;
mod reference;
mod requirements;
mod service;
mod service_api;
mod service_cli;
mod service_network;
mod service_origins;
mod service_promises;
mod service_support;
mod tiers;
mod training;
mod turntable;
