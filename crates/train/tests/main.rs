//! Training, rendering and evaluation through the public interface, on the CPU and on the GPU.

// Helpers of tests are tests: a failed one should say where.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod exposures;
mod gpu;
mod gpu_rays;
mod lights;
mod support;
mod tiers;
mod training;
mod turntable;
